//! The loop: connect, read sweeps, send them; when the device goes away, say so and connect again.

use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

use mirador_ipc_schema::messages::{Beam, Header, LaserSweepMeta, ScanId, ScanRequestKind};
use mirador_ipc_schema::service::{HEARTBEAT, HealthReporter, ServiceSetup};
use mirador_ipc_schema::{Participant, Publisher, Subscriber, clock, topics};
use mirador_service_common::ServiceError;

use crate::LaserDriverConfig;
use crate::cola::{Event, ScanData, Session, SessionError};
use crate::device_clock::DeviceClock;

/// A connection that is not made within this time is tried again.
const CONNECT: Duration = Duration::from_secs(2);
/// Clock of the stamps: CLOCK_REALTIME.
const REALTIME: u32 = 1;

/// Sends the sweeps of the configured device until the process is stopped.
///
/// # Errors
/// When the config is wrong or the graph cannot be joined; a device that is not there is waited for.
pub fn run(setup: &ServiceSetup, config: &LaserDriverConfig) -> Result<(), ServiceError> {
    config.validate().map_err(|e| ServiceError::Config(e.to_string()))?;
    let participant = setup.join()?;
    let mut driver = Driver {
        setup,
        config,
        sweeps: participant.publisher()?,
        requests: participant.subscriber()?,
        health: HealthReporter::open(&participant, &setup.name)?,
        clock: DeviceClock::default(),
        scan: u32::MAX,
        sweep: SweepCount::default(),
        bad: 0,
    };
    driver.health.running(&participant);
    while !setup.stop.is_set() {
        let fault = match driver.converse(&participant) {
            Ok(()) => break,
            Err(Fault::Graph(error)) => return Err(error),
            Err(Fault::Device(SessionError::Stopped)) => break,
            Err(Fault::Device(error)) => error.to_string(),
        };
        tracing::warn!(device = config.address, fault, "the laser cannot be read");
        driver.health.message(&format!("{}: {fault}", config.address));
        driver.pause(&participant, Duration::from_secs_f64(config.retry_s))?;
    }
    Ok(())
}

/// Why a conversation ends.
enum Fault {
    /// The device, the net, or what came over it.
    Device(SessionError),
    /// The graph.
    Graph(ServiceError),
}

impl<E: Into<ServiceError>> From<E> for Fault {
    fn from(error: E) -> Self {
        Self::Graph(error.into())
    }
}

struct Driver<'a> {
    setup: &'a ServiceSetup,
    config: &'a LaserDriverConfig,
    sweeps: Publisher<topics::LaserSweep>,
    requests: Subscriber<topics::ScanRequests>,
    health: HealthReporter,
    clock: DeviceClock,
    /// The scan that was asked for last; u32::MAX before the first.
    scan: u32,
    sweep: SweepCount,
    /// Telegrams that were not sweeps.
    bad: u64,
}

impl Driver<'_> {
    /// From connecting to the end of the connection.
    fn converse(&mut self, participant: &Participant) -> Result<(), Fault> {
        let stream = self.connect().map_err(Fault::Device)?;
        let stop = self.setup.stop.clone();
        let mut session = Session::open(stream, &|| stop.is_set()).map_err(Fault::Device)?;
        self.clock = DeviceClock::default();
        self.sweep.reconnected();
        self.health.message("");
        let silence = Duration::from_secs_f64(self.config.silence_s);
        let (mut events, mut heard) = (Vec::new(), Instant::now());
        while !self.setup.stop.is_set() {
            session.receive(&mut events).map_err(Fault::Device)?;
            let arrived_ns = i64::try_from(clock::utc_ns()).unwrap_or(i64::MAX);
            self.note_requests()?;
            for event in events.drain(..) {
                match event {
                    Event::Sweep(sweep) => {
                        heard = Instant::now();
                        self.send(&sweep, arrived_ns)?;
                    }
                    Event::Bad(error) => {
                        self.bad += 1;
                        tracing::warn!(device = self.config.address, %error, "a telegram is passed over");
                    }
                }
            }
            if heard.elapsed() > silence {
                return Err(Fault::Device(SessionError::Silent("sEN LMDscandata 1".into())));
            }
            self.say_counts(session.garbage());
            self.health.heartbeat(participant);
        }
        Ok(())
    }

    fn connect(&self) -> Result<TcpStream, SessionError> {
        let mut last = std::io::Error::other("the name has no address");
        for address in self.config.address.to_socket_addrs()? {
            match TcpStream::connect_timeout(&address, CONNECT) {
                Ok(stream) => {
                    stream.set_nodelay(true)?;
                    stream.set_read_timeout(Some(HEARTBEAT))?;
                    stream.set_write_timeout(Some(CONNECT))?;
                    return Ok(stream);
                }
                Err(error) => last = error,
            }
        }
        Err(last.into())
    }

    /// Sweeps carry the scan that was asked for last.
    fn note_requests(&mut self) -> Result<(), ServiceError> {
        while let Some(message) = self.requests.receive()? {
            let taken = message.items().iter().filter(|request| request.kind == ScanRequestKind::TAKE);
            self.scan = taken.map(|request| request.scan).next_back().unwrap_or(self.scan);
        }
        Ok(())
    }

    fn send(&mut self, data: &ScanData, arrived_ns: i64) -> Result<(), ServiceError> {
        let Some(sweep) = self.sweep.next(data.scan_counter) else { return Ok(()) };
        let id = ScanId { robot: 0, run: self.setup.run, scan: self.scan }.pack();
        let stamp_ns = self.clock.ours_ns(data.measured_us, data.sent_us, arrived_ns);
        let last = data.ranges.len().saturating_sub(1).max(1) as f64;
        // The mirror turns once a sweep.
        let duration_s = last * data.angle_step_deg / 360.0 / data.scan_frequency;
        let beams = data.ranges.len().min(self.sweeps.capacity());
        let mut loan = self.sweeps.loan(beams)?;
        *loan.meta_mut() = LaserSweepMeta {
            header: Header { clock_id: REALTIME, ..Header::new(id, stamp_ns) },
            duration_ns: (duration_s * 1e9) as u64,
            first_angle: data.start_angle_deg.to_radians(),
            angle_step: data.angle_step_deg.to_radians(),
            sweep,
            reserved: 0,
            range_max: self.config.range_max_m,
        };
        for (k, beam) in loan.items_mut().iter_mut().enumerate() {
            let range = data.ranges.get(k).copied().unwrap_or(0.0);
            let is_return = range > 0.0 && f64::from(range) <= self.config.range_max_m;
            *beam = Beam {
                range: if is_return { range } else { f32::NAN },
                intensity: data.strengths.get(k).copied().unwrap_or(0),
                time: (65535.0 * k as f64 / last).round() as u16,
            };
        }
        Ok(loan.send()?)
    }

    fn say_counts(&mut self, garbage: u64) {
        if self.bad + garbage + self.sweep.missing + self.sweep.repeated > 0 {
            let SweepCount { missing, repeated, .. } = self.sweep;
            let bad = self.bad;
            self.health.message(&format!(
                "{missing} sweeps missing, {repeated} repeated, {bad} telegrams passed over, {garbage} bytes of no telegram"
            ));
        }
    }

    /// Waits, and stays alive meanwhile.
    fn pause(&mut self, participant: &Participant, time: Duration) -> Result<(), ServiceError> {
        let begin = Instant::now();
        while !self.setup.stop.is_set() && begin.elapsed() < time {
            participant.wait(&[&self.requests], HEARTBEAT.min(time));
            self.note_requests()?;
            self.health.heartbeat(participant);
        }
        Ok(())
    }
}

/// Counts sweeps on over the 16 bits of the device's counter, and sees gaps and repetitions.
#[derive(Debug, Default)]
struct SweepCount {
    last: Option<u16>,
    count: u32,
    missing: u64,
    repeated: u64,
}

impl SweepCount {
    /// The number of a sweep; `None` for one that came before.
    fn next(&mut self, counter: u16) -> Option<u32> {
        let step = self.last.map_or(1, |last| counter.wrapping_sub(last));
        // Half of the range backwards is what is old.
        if step == 0 || step > u16::MAX / 2 {
            self.repeated += 1;
            return None;
        }
        self.last = Some(counter);
        self.missing += u64::from(step - 1);
        let number = self.count.wrapping_add(u32::from(step) - 1);
        self.count = number.wrapping_add(1);
        Some(number)
    }

    /// What the device counted while nobody listened is no loss.
    fn reconnected(&mut self) {
        self.last = None;
    }
}

#[cfg(test)]
#[path = "service_tests.rs"]
mod tests;
