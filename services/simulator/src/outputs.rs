//! What the robot says, as messages.

use mirador_core::geometry::rows_from_pose;
use mirador_core::simulation::{
    GnssReading, LaserBeam, LaserSweep, Motion, PlanarSweep, RangerMount, Readings, Robot, ScannerConfig, SensorKind,
    SensorsConfig,
};
use mirador_ipc_schema::messages::{
    Battery, Beam, EncoderReading, Envelope, Gnss, Header, Imu, LaserSweepMeta, Magnetometer, Odometry, PlanarScanMeta,
    Ranger, RobotState, ScanId,
};
use mirador_ipc_schema::{LoanError, Participant, PortError, PublishError, Publisher, SendFailure, Topic, topics};
use mirador_service_common::ServiceError;

/// Simulated seconds as the stamps of messages.
pub(crate) fn stamp_ns(time: f64) -> i64 {
    (time * 1e9).round() as i64
}

/// What a control step ends with.
#[derive(Debug, Clone, Copy)]
pub(crate) struct State {
    pub motion: Option<Motion>,
    pub emergency_stop: bool,
    pub tipped: bool,
    pub scanning: bool,
    /// Scans the head has turned for.
    pub scans: u32,
}

/// The topics of the robot's sensors.
pub(crate) struct Outputs {
    run: u32,
    sensors: SensorsConfig,
    scanner: ScannerConfig,
    robot: Robot,
    mounts: Vec<RangerMount>,
    sweeps: Publisher<topics::LaserSweep>,
    encoder: Publisher<topics::Encoder>,
    planar: Publisher<topics::PlanarScan>,
    odometry: Publisher<topics::Odometry>,
    imu: Publisher<topics::Imu>,
    gnss: Publisher<topics::Gnss>,
    magnetometer: Publisher<topics::Magnetometer>,
    rangers: Publisher<topics::Rangers>,
    battery: Publisher<topics::Battery>,
    state: Publisher<topics::RobotState>,
}

/// The robot as its messages describe it.
pub(crate) struct Described {
    pub sensors: SensorsConfig,
    pub scanner: ScannerConfig,
    pub robot: Robot,
    pub mounts: Vec<RangerMount>,
}

impl Outputs {
    pub fn open(participant: &Participant, run: u32, described: Described) -> Result<Self, PortError> {
        let Described { sensors, scanner, robot, mounts } = described;
        for sensor in robot.sensors.iter().filter(|sensor| is_planar(&sensor.kind)) {
            if !is_level(sensor.rotation) {
                tracing::warn!(
                    sensor = sensor.name,
                    "this laser is tilted, which planar_scan cannot say: it is not published"
                );
            }
        }
        Ok(Self {
            run,
            sensors,
            scanner,
            robot,
            mounts,
            sweeps: participant.publisher()?,
            encoder: participant.publisher()?,
            planar: participant.publisher()?,
            odometry: participant.publisher()?,
            imu: participant.publisher()?,
            gnss: participant.publisher()?,
            magnetometer: participant.publisher()?,
            rangers: participant.publisher()?,
            battery: participant.publisher()?,
            state: participant.publisher()?,
        })
    }

    /// Says what the sensors have said in a control step; `scan` is what the head turns for, or has turned for last.
    pub fn say(&self, readings: &Readings, scan: u32) -> Result<(), ServiceError> {
        let id = ScanId { robot: 0, run: self.run, scan }.pack();
        let sensors = &self.sensors;
        send_all(&self.odometry, id, &readings.odometry, |r| {
            let (sin, cos) = (0.5 * r.pose[2]).sin_cos();
            Odometry {
                stamp_ns: stamp_ns(r.time),
                position: [r.pose[0], r.pose[1], 0.0],
                orientation: [0.0, 0.0, sin, cos],
                linear: r.linear,
                angular: r.angular,
                distance: r.distance,
            }
        })?;
        send_all(&self.imu, id, &readings.imu, |r| Imu {
            stamp_ns: stamp_ns(r.time),
            acceleration: r.acceleration.into(),
            angular_velocity: r.angular_velocity.into(),
            acceleration_sigma: sensors.imu.acceleration_sigma,
            angular_velocity_sigma: sensors.imu.angular_sigma,
            temperature: 0.0,
        })?;
        send_all(&self.gnss, id, &readings.gnss, gnss)?;
        send_all(&self.magnetometer, id, &readings.magnetometer, |r| Magnetometer {
            stamp_ns: stamp_ns(r.time),
            field: r.field.into(),
            sigma: sensors.magnetometer.sigma,
        })?;
        send_all(&self.rangers, id, &readings.rangers, |r| {
            let mount = self.mounts.get(r.sensor);
            Ranger {
                stamp_ns: stamp_ns(r.time),
                mount_xyz: mount.map_or([0.0; 3], |mount| mount.position.into()),
                mount_yaw_pitch: mount.map_or([0.0; 2], |mount| mount.yaw_pitch),
                aperture: sensors.rangers.aperture_deg.to_radians(),
                range: r.range as f32,
                sensor: r.sensor as u32,
            }
        })?;
        send_all(&self.battery, id, &readings.battery, |r| Battery {
            stamp_ns: stamp_ns(r.time),
            voltage: r.voltage,
            current: r.current,
            charge: r.charge,
            low: u32::from(r.is_low),
            reserved: 0,
        })?;
        for sweep in &readings.planar {
            self.say_planar(id, sweep)?;
        }
        for sweep in &readings.sweeps {
            self.say_sweep(id, sweep)?;
        }
        send_all(&self.encoder, id, &readings.ticks, |r| EncoderReading {
            stamp_ns: stamp_ns(r.time),
            angle: r.angle,
            velocity: r.velocity,
            home: u32::from(r.is_home),
            reading: r.reading,
        })
    }

    /// Says that everything up to `time` is said.
    pub fn say_state(&self, time: f64, state: &State) -> Result<(), ServiceError> {
        let id = ScanId { robot: 0, run: self.run, scan: state.scans }.pack();
        let item = RobotState {
            map_from_robot: state.motion.map_or([0.0; 16], |motion| rows_from_pose(&motion.pose)),
            linear: state.motion.map_or(0.0, |motion| (motion.pose.rotation.inverse() * motion.linear).x),
            emergency_stop: u32::from(state.emergency_stop),
            tipped: u32::from(state.tipped),
            scanning: u32::from(state.scanning),
            scans: state.scans,
        };
        reached(self.state.send_one(Envelope { header: Header::new(id, stamp_ns(time)) }, item))
    }

    /// Gives late joiners what they missed.
    pub fn serve_late_joiners(&self) {
        self.state.serve_late_joiners();
        self.battery.serve_late_joiners();
        // Without a history, but a reader that joins is then connected before the next message.
        self.sweeps.serve_late_joiners();
        self.encoder.serve_late_joiners();
    }

    fn say_planar(&self, id: u64, sweep: &PlanarSweep) -> Result<(), ServiceError> {
        let Some(sensor) = self.robot.sensors.get(sweep.sensor).filter(|sensor| is_level(sensor.rotation)) else {
            return Ok(());
        };
        let (range_max, angle_step) = match sensor.kind {
            SensorKind::Laser2d { range, resolution, .. } => (range, resolution),
            SensorKind::Laser1d { range, .. } => (range, 0.0),
            _ => return Ok(()),
        };
        let meta = PlanarScanMeta {
            header: Header::new(id, stamp_ns(sweep.time)),
            first_angle: -0.5 * angle_step * sweep.beams.len().saturating_sub(1) as f64,
            angle_step,
            range_max,
            // The simulated laser fires all its beams at once.
            duration_ns: 0,
            mount_xyz: sensor.position,
            mount_yaw: sensor.rotation[2],
            sensor: sweep.sensor as u32,
            reserved: 0,
        };
        send(&self.planar, meta, &sweep.beams, beam)
    }

    fn say_sweep(&self, id: u64, sweep: &LaserSweep) -> Result<(), ServiceError> {
        let meta = LaserSweepMeta {
            header: Header::new(id, stamp_ns(sweep.time)),
            duration_ns: stamp_ns(sweep.duration).unsigned_abs(),
            first_angle: sweep.first_angle,
            angle_step: sweep.angle_step,
            sweep: sweep.sweep,
            reserved: 0,
            range_max: self.scanner.range_max_m,
        };
        send(&self.sweeps, meta, &sweep.beams, beam)
    }
}

fn beam(beam: &LaserBeam) -> Beam {
    Beam { range: beam.range, intensity: beam.intensity, time: beam.time }
}

fn gnss(reading: &GnssReading) -> Gnss {
    Gnss {
        stamp_ns: stamp_ns(reading.time),
        latitude: reading.latitude,
        longitude: reading.longitude,
        height: reading.height,
        velocity: reading.velocity.into(),
        sigma: reading.sigma.into(),
        fix: u32::from(reading.has_fix),
        satellites: reading.satellites,
    }
}

fn is_planar(kind: &SensorKind) -> bool {
    matches!(kind, SensorKind::Laser1d { .. } | SensorKind::Laser2d { .. })
}

/// Whether a sensor is turned about z only.
fn is_level(rotation: [f64; 3]) -> bool {
    rotation[0].abs() < 1e-9 && rotation[1].abs() < 1e-9
}

/// Sends readings, when there are any; the stamp is that of the last.
fn send_all<T: Topic<Meta = Envelope>, R>(
    publisher: &Publisher<T>,
    id: u64,
    readings: &[R],
    item: impl Fn(&R) -> T::Item,
) -> Result<(), ServiceError>
where
    T::Item: Stamped,
{
    for readings in readings.chunks(publisher.capacity().max(1)) {
        let stamp_ns = readings.last().map_or(0, |reading| item(reading).stamp_ns());
        send(publisher, Envelope { header: Header::new(id, stamp_ns) }, readings, &item)?;
    }
    Ok(())
}

/// Writes items in place and sends them.
fn send<T: Topic, R>(
    publisher: &Publisher<T>,
    meta: T::Meta,
    readings: &[R],
    item: impl Fn(&R) -> T::Item,
) -> Result<(), ServiceError> {
    let mut loan = match publisher.loan(readings.len()) {
        Ok(loan) => loan,
        Err(error @ LoanError::TooLarge { .. }) => return Err(ServiceError::Work(error.to_string())),
        Err(error) => return Err(error.into()),
    };
    *loan.meta_mut() = meta;
    for (out, reading) in loan.items_mut().iter_mut().zip(readings) {
        *out = item(reading);
    }
    reached(loan.send().map_err(PublishError::from))
}

/// A reader that hangs misses a message and sees that; the robot goes on.
fn reached(sent: Result<(), PublishError>) -> Result<(), ServiceError> {
    match sent {
        Err(PublishError::Send(error @ SendFailure::Undelivered { .. })) => {
            tracing::warn!(%error, "the simulation goes on without it");
            Ok(())
        }
        other => Ok(other?),
    }
}

/// An item with a time of its own.
pub(crate) trait Stamped {
    /// Its time [ns].
    fn stamp_ns(&self) -> i64;
}

macro_rules! stamped {
    ($($item:ty),*) => {$(
        impl Stamped for $item {
            fn stamp_ns(&self) -> i64 { self.stamp_ns }
        }
    )*};
}
stamped!(Odometry, Imu, Gnss, Magnetometer, Ranger, Battery, EncoderReading);
