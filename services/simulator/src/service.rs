//! The loop: what the sensors said, the state, navigation's answer, the next step.

use std::time::{Duration, Instant};

use mirador_core::navigation::{Arbitration, Conditions, MotionSources, Reference, Source, Standstill};
use mirador_core::simulation::{Readings, Simulator};
use mirador_ipc_schema::messages::{MotionCommand, ScanRequestKind};
use mirador_ipc_schema::service::{HEARTBEAT, HealthReporter, ServiceSetup};
use mirador_ipc_schema::{Participant, RollCall, Subscriber, topics};
use mirador_service_common::ServiceError;

use crate::outputs::{Described, Outputs, State, stamp_ns};
use crate::wheels;
use crate::{ConfigError, SimulatorConfig};

/// In lockstep an answer that is missing for so long is worth a line in the log.
const PATIENCE: Duration = Duration::from_secs(10);
/// Numbers of sources in a `motion_command`.
const EMERGENCY: u32 = 0;
const NAVIGATION: u32 = 4;

/// Simulates the configured world until the process is stopped.
///
/// # Errors
/// See [`ServiceError`].
pub fn run(setup: &ServiceSetup, config: &SimulatorConfig) -> Result<(), ServiceError> {
    let mut service = Service::open(setup, config)?;
    service.wait_for_services()?;
    tracing::info!(world = config.world, robot = config.robot, seed = config.seed, "the world is there");
    let begin = Instant::now();
    while !setup.stop.is_set() {
        service.say()?;
        if config.speed == 0.0 {
            service.wait_for_answer()?;
        } else {
            let due = begin + Duration::from_secs_f64((service.time() + config.control_period_s) / config.speed);
            service.wait_until(due)?;
        }
        service.advance();
    }
    Ok(())
}

/// What the head turns for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Turn {
    scan: u32,
    /// The scan had been taken before; nobody but acquisition knows that it is taken again.
    again: bool,
}

struct Service<'a> {
    setup: &'a ServiceSetup,
    config: &'a SimulatorConfig,
    participant: Participant,
    outputs: Outputs,
    commands: Subscriber<topics::MotionCommand>,
    requests: Subscriber<topics::ScanRequests>,
    others: Subscriber<topics::ServiceHealth>,
    health: HealthReporter,
    simulator: Simulator,
    /// One for every robot up to the one that drives, whose readings are the last.
    readings: Vec<Readings>,
    sources: MotionSources,
    conditions: Conditions,
    max_speed: f64,
    /// Stamp of the last step that navigation has answered [ns].
    answered_ns: Option<i64>,
    asked: Option<Turn>,
    turn: Option<Turn>,
    /// Scans the head has turned for.
    scans: u32,
    standstill: Option<Standstill>,
    stepping: Duration,
}

impl<'a> Service<'a> {
    fn open(setup: &'a ServiceSetup, config: &'a SimulatorConfig) -> Result<Self, ServiceError> {
        let wrong = |error: ConfigError| ServiceError::Config(error.to_string());
        let simulator = config.simulator(setup.threads).map_err(wrong)?;
        let driven = config.driven().map_err(wrong)?;
        let participant = setup.join()?;
        let max_speed = driven.robot.max_speed;
        let mounts = simulator.ranger_mounts(config.robot).to_vec();
        let described = Described { sensors: config.sensors, scanner: driven.scanner, robot: driven.robot, mounts };
        Ok(Self {
            setup,
            config,
            commands: participant.subscriber()?,
            requests: participant.subscriber()?,
            others: participant.subscriber()?,
            outputs: Outputs::open(&participant, setup.run, described)?,
            health: HealthReporter::open(&participant, &setup.name)?,
            simulator,
            readings: vec![Readings::default(); config.robot + 1],
            sources: MotionSources::default(),
            conditions: Conditions::default(),
            max_speed,
            answered_ns: None,
            asked: None,
            turn: None,
            scans: 0,
            standstill: None,
            stepping: Duration::ZERO,
            participant,
        })
    }

    fn time(&self) -> f64 {
        self.simulator.time()
    }

    fn now_ns(&self) -> i64 {
        stamp_ns(self.time())
    }

    /// Waits until every service that time waits for is there and hears everything.
    fn wait_for_services(&mut self) -> Result<(), ServiceError> {
        self.health.running(&self.participant);
        let mut call = RollCall::of(&self.config.lockstep_with);
        while !self.setup.stop.is_set() && !call.is_complete() {
            self.participant.wait(&[&self.others], HEARTBEAT);
            while let Some(message) = self.others.receive()? {
                message.items().iter().for_each(|health| call.hear(message.header(), health));
            }
            self.keep_alive();
        }
        Ok(())
    }

    /// Says what the sensors have said since the last step, and that this was all.
    fn say(&mut self) -> Result<(), ServiceError> {
        let robot = self.config.robot;
        let scan = self.turn.map_or(self.scans.saturating_sub(1), |turn| turn.scan);
        let time = self.time();
        if let Some(readings) = self.readings.last_mut() {
            // The drives know of the battery themselves.
            if let Some(battery) = readings.battery.last() {
                self.conditions.battery_low = battery.is_low;
            }
            self.config.faults.iter().for_each(|fault| fault.spoil(time, readings));
            self.outputs.say(readings, scan)?;
        }
        self.conditions.tipped = self.simulator.has_tipped(robot);
        if let Some(turn) = self.turn.filter(|_| !self.simulator.is_scanning(robot)) {
            self.turn = None;
            self.scans = self.scans.max(turn.scan.saturating_add(1));
            self.health.finished(&self.participant, self.scans, self.stepping);
            self.stepping = Duration::ZERO;
        }
        let state = State {
            motion: self.simulator.truth(robot),
            emergency_stop: self.sources.is_stopped(),
            tipped: self.conditions.tipped,
            // A head that is asked to turn is as good as turning.
            scanning: self.turn.is_some(),
            scans: self.scans,
        };
        self.outputs.say_state(self.time(), &state)
    }

    /// In lockstep: waits until navigation has said what to do from now on. While a scan is taken again nobody is asked:
    /// navigation may be waiting for what comes of that very scan.
    fn wait_for_answer(&mut self) -> Result<(), ServiceError> {
        let (since, mut is_said) = (Instant::now(), false);
        while !self.setup.stop.is_set() {
            self.listen()?;
            let is_again = self.turn.or(self.asked).is_some_and(|turn| turn.again);
            if is_again || self.answered_ns.is_some_and(|stamp| stamp >= self.now_ns()) {
                return Ok(());
            }
            if !is_said && since.elapsed() > PATIENCE {
                is_said = true;
                tracing::warn!(time = self.time(), "navigation has not answered this step for 10 s; the robot stands");
            }
            self.participant.wait(&[&self.commands, &self.requests], HEARTBEAT);
            self.keep_alive();
        }
        Ok(())
    }

    /// Without lockstep: takes what is said until the next step is due.
    fn wait_until(&mut self, due: Instant) -> Result<(), ServiceError> {
        loop {
            self.listen()?;
            self.keep_alive();
            let left = due.saturating_duration_since(Instant::now());
            if left.is_zero() || self.setup.stop.is_set() {
                return Ok(());
            }
            self.participant.wait(&[&self.commands, &self.requests], left.min(HEARTBEAT));
        }
    }

    /// Takes commands and requests.
    fn listen(&mut self) -> Result<(), ServiceError> {
        while let Some(message) = self.commands.receive()? {
            for command in message.items() {
                self.take(command);
            }
        }
        while let Some(message) = self.requests.receive()? {
            for request in message.items().iter().filter(|request| request.kind == ScanRequestKind::TAKE) {
                self.ask(request.scan);
            }
        }
        Ok(())
    }

    fn take(&mut self, command: &MotionCommand) {
        let now_ns = self.now_ns();
        let &MotionCommand { stamp_ns, linear, angular, valid_ns, source, .. } = command;
        if source == EMERGENCY {
            if valid_ns == 0 {
                self.sources.release_emergency_stop();
            } else {
                self.sources.press_emergency_stop();
            }
            return;
        }
        let known = usize::try_from(source - 1).ok().and_then(|source| Source::ALL.get(source).copied());
        let Some(named) = known else {
            tracing::warn!(source, "a motion command of an unknown source is passed over; sources are 0 to 4");
            return;
        };
        // An answer is an answer, also when it cannot be followed.
        if source == NAVIGATION {
            self.answered_ns = self.answered_ns.max(Some(stamp_ns));
        }
        if let Err(refusal) = self.sources.give(named, Reference { stamp_ns, valid_ns, linear, angular }, now_ns) {
            tracing::warn!(source = named.name(), %refusal, "a motion command is passed over");
        }
    }

    /// A new scan, or the one at this place again.
    fn ask(&mut self, scan: u32) {
        if scan.saturating_add(1) < self.scans {
            tracing::warn!(scan, scans = self.scans, "a scan cannot be taken again from another place");
            return;
        }
        self.asked = Some(Turn { scan, again: scan < self.scans });
    }

    /// Starts the head when it was asked to, drives, and lets a control step pass.
    fn advance(&mut self) {
        let begin = Instant::now();
        let robot = self.config.robot;
        if let Some(turn) = self.asked.take() {
            match self.simulator.start_scan(robot) {
                Ok(()) => self.turn = Some(turn),
                Err(error) => tracing::warn!(%error, scan = turn.scan, "the scan cannot be taken"),
            }
        }
        let decision = self.sources.decide(self.now_ns(), self.conditions);
        self.note(decision);
        let [left, right] = match decision {
            Arbitration::Drive { linear, angular, .. } if !self.turn.is_some_and(|turn| turn.again) => {
                wheels::speeds(linear, angular, self.config.sensors.odometry.track, self.max_speed)
            }
            _ => [0.0; 2],
        };
        if let Err(error) = self.simulator.drive(robot, left, right) {
            tracing::warn!(%error, "the robot cannot be driven");
        }
        for readings in &mut self.readings {
            readings.clear();
        }
        for _ in 0..self.config.physics_steps() {
            self.simulator.step(&mut self.readings);
        }
        self.stepping += begin.elapsed();
    }

    /// Says when the robot is stopped by something other than the end of a reference, and when it is free again.
    fn note(&mut self, decision: Arbitration) {
        let standstill = match decision {
            Arbitration::Stand(why) if why != Standstill::NoReference => Some(why),
            _ => None,
        };
        if standstill != self.standstill {
            match standstill {
                Some(why) => {
                    tracing::warn!(?why, time = self.time(), "the robot is stopped");
                    self.health.message(&format!("the robot is stopped: {why:?}"));
                }
                None => {
                    tracing::info!(time = self.time(), "the robot may drive again");
                    self.health.message("");
                }
            }
            self.standstill = standstill;
        }
    }

    fn keep_alive(&mut self) {
        self.outputs.serve_late_joiners();
        self.health.heartbeat(&self.participant);
    }
}
