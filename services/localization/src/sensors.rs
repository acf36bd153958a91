//! The sensors' topics, drained into the filter.

use mirador_core::localization::{GnssSample, ImuSample, Localizer, MagneticSample, SweepSample, WheelSample};
use mirador_ipc_schema::{Participant, Subscriber, topics};
use mirador_service_common::ServiceError;

pub(crate) struct Sensors {
    imu: Subscriber<topics::Imu>,
    odometry: Subscriber<topics::Odometry>,
    gnss: Subscriber<topics::Gnss>,
    magnetometer: Subscriber<topics::Magnetometer>,
    laser: Subscriber<topics::PlanarScan>,
    /// The mount of the laser that was heard first: sweeps of others are not compared with its own.
    laser_mount: Option<([f64; 3], f64)>,
    refused: u64,
}

impl Sensors {
    pub fn open(participant: &Participant) -> Result<Self, ServiceError> {
        Ok(Self {
            imu: participant.subscriber()?,
            odometry: participant.subscriber()?,
            gnss: participant.subscriber()?,
            magnetometer: participant.subscriber()?,
            laser: participant.subscriber()?,
            laser_mount: None,
            refused: 0,
        })
    }

    /// Takes everything in that has been said.
    pub fn drain(&mut self, localizer: &mut Localizer) -> Result<(), ServiceError> {
        while let Some(message) = self.imu.receive()? {
            for m in message.items() {
                let (acceleration, angular_velocity) = (m.acceleration.into(), m.angular_velocity.into());
                localizer.imu(ImuSample { stamp_ns: m.stamp_ns, acceleration, angular_velocity });
            }
        }
        while let Some(message) = self.odometry.receive()? {
            for m in message.items() {
                localizer.wheels(WheelSample { stamp_ns: m.stamp_ns, linear: m.linear, angular: m.angular });
            }
        }
        while let Some(message) = self.gnss.receive()? {
            for m in message.items().iter().filter(|m| m.fix > 0) {
                localizer.gnss(GnssSample {
                    stamp_ns: m.stamp_ns,
                    latitude: m.latitude,
                    longitude: m.longitude,
                    height: m.height,
                    velocity: m.velocity.into(),
                    sigma: m.sigma.into(),
                });
            }
        }
        while let Some(message) = self.magnetometer.receive()? {
            for m in message.items() {
                localizer.magnetometer(MagneticSample { stamp_ns: m.stamp_ns, field: m.field.into() });
            }
        }
        while let Some(message) = self.laser.receive()? {
            let meta = message.meta();
            let mount = (meta.mount_xyz, meta.mount_yaw);
            if *self.laser_mount.get_or_insert(mount) != mount {
                continue;
            }
            localizer.sweep(SweepSample {
                stamp_ns: meta.header.stamp_ns,
                first_angle: meta.first_angle,
                angle_step: meta.angle_step,
                mount_xyz: meta.mount_xyz,
                mount_yaw: meta.mount_yaw,
                ranges: message.items().iter().map(|beam| beam.range).collect(),
            });
        }
        self.tell(localizer);
        Ok(())
    }

    /// Says what was refused, at the first, the second, the fourth time and so on.
    fn tell(&mut self, localizer: &Localizer) {
        let refused = localizer.counters().refused;
        let [imu, wheels] = [refused.imu.total(), refused.wheels.total()];
        let [gnss, magnetometer, laser] = [refused.gnss, refused.magnetometer, refused.laser].map(|of| of.total());
        let total = imu + wheels + gnss + magnetometer + laser;
        if total > 0 && total >= 2 * self.refused {
            tracing::warn!(imu, wheels, gnss, magnetometer, laser, "readings were refused: bad values or stamps");
            self.refused = total;
        }
    }
}
