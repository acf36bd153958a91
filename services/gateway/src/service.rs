//! The gateway's loop: take what was said, draw it for whoever looks, show newcomers what there is.

use std::time::{Duration, Instant};

use mirador_ipc_schema::service::{HEARTBEAT, HealthReporter, ServiceSetup};
use mirador_ipc_schema::topics::Topic;
use mirador_ipc_schema::{Participant, PortError, Subscriber, Wakeable, clock, for_each_topic};
use mirador_recorder::{RUN_FILE, RunReader};
use mirador_service_common::{Courtesy, ServiceError};
use mirador_viewers::{TOPICS, View, ViewConfig};

use crate::GatewayConfig;
use crate::server::{Listening, Server};

/// How much lower than others the process's priority is.
const NICENESS: i32 = 10;
/// When nothing of the run was said for so long, no plan is being worked on.
const QUIET: Duration = Duration::from_millis(500);
/// At the end viewers have so long to take what is in their queues.
const LAST_WORDS: Duration = Duration::from_millis(250);

/// Serves a run to viewers until it is asked to stop.
///
/// A port that cannot be listened on does not end it: it says so, and tries again. After a restart it reads from the
/// recording what was said before.
///
/// # Errors
/// See [`ServiceError`].
pub fn run(setup: &ServiceSetup, config: &GatewayConfig) -> Result<(), ServiceError> {
    config.validate().map_err(ServiceError::Config)?;
    // Threads that are started later inherit it. Without it pictures come at the price of plans, so it is worth a line.
    if let Err(error) = rustix::process::nice(NICENESS) {
        tracing::warn!(%error, "the priority cannot be lowered");
    }
    let participant = setup.join()?;
    let mut health = HealthReporter::open(&participant, &setup.name)?;
    // Before it listens: a reader that reads an old recording meanwhile would hold up the graph.
    let mut gateway = Gateway::open(setup, config)?;
    let taps = open_taps(&participant)?;
    let worth_waking = taps.iter().filter(|tap| Courtesy::wakes(tap.topic()));
    let ports: Vec<&dyn Wakeable> = worth_waking.map(|tap| tap.port()).collect();
    let mut courtesy = Courtesy::default();
    health.running(&participant);
    while !setup.stop.is_set() {
        participant.wait(&ports, HEARTBEAT);
        let ready = taps.iter().filter(|tap| tap.port().is_ready()).map(|tap| tap.topic());
        let makes_way = !courtesy.is_over(ready);
        for tap in taps.iter().filter(|tap| !makes_way || !Courtesy::holds(tap.topic())) {
            tap.drain(&mut gateway)?;
        }
        gateway.serve(&mut health);
        health.heartbeat(&participant);
    }
    for tap in &taps {
        tap.drain(&mut gateway)?;
    }
    gateway.finish();
    Ok(())
}

struct Gateway {
    view: View,
    server: Server,
    heard: Instant,
    clients: usize,
    /// Where viewers find it, or why they cannot.
    place: String,
}

impl Gateway {
    fn open(setup: &ServiceSetup, config: &GatewayConfig) -> Result<Self, ServiceError> {
        let server = Server::new(&format!("mirador {}", setup.domain.name()), config).map_err(ServiceError::Work)?;
        // Viewers set live data beside the time of day.
        let clock_offset_ns = clock::utc_ns().saturating_sub(clock::monotonic_ns());
        let mut view = View::new(ViewConfig { most_points: config.points, share: None, clock_offset_ns });
        if setup.incarnation > 0 {
            restore(&mut view, setup);
        }
        Ok(Self { view, server, heard: Instant::now(), clients: 0, place: String::new() })
    }

    fn take<T: Topic>(&mut self, meta: &T::Meta, items: &[T::Item]) {
        if T::RULES.name != "service_health" {
            self.heard = Instant::now();
        }
        let Ok(()) = self.view.take::<T, _>(&mut self.server, meta, items);
    }

    /// Draws what waits, and leaves viewers a moment to take it.
    fn finish(mut self) {
        let Ok(()) = self.view.finish(&mut self.server);
        if self.server.clients() > 0 {
            std::thread::sleep(LAST_WORDS);
        }
        self.server.stop();
    }

    /// Looks after viewers.
    fn serve(&mut self, health: &mut HealthReporter) {
        match self.server.listen() {
            Listening::AsBefore => {}
            Listening::At(port) => {
                self.place = format!("live at ws://127.0.0.1:{port}");
                tracing::info!("{}", self.place);
                health.message(&self.place);
            }
            Listening::Failed(why) if why == self.place => {}
            Listening::Failed(why) => {
                tracing::error!("{why}");
                health.message(&why);
                self.place = why;
            }
        }
        if self.heard.elapsed() > QUIET {
            let Ok(()) = self.view.settle(&mut self.server);
            self.heard = Instant::now();
        }
        for (client, channel) in self.server.newcomers() {
            let Ok(()) = self.view.present(&mut self.server.only_for(client), &channel);
        }
        let clients = self.server.clients();
        if clients != self.clients {
            tracing::info!(clients, "viewers");
            self.clients = clients;
        }
    }
}

/// Takes in what was said before this incarnation.
fn restore(view: &mut View, setup: &ServiceSetup) {
    let path = setup.run_dir.join(RUN_FILE);
    let restored =
        RunReader::open(&path).and_then(|mut run| run.for_each_message(|topic, data| view.restore(topic, data)));
    if let Err(error) = restored {
        tracing::warn!(%error, "what was said before the restart is not shown");
    }
}

/// A topic being listened to.
trait Tap {
    fn topic(&self) -> &'static str;
    fn port(&self) -> &dyn Wakeable;
    fn drain(&self, gateway: &mut Gateway) -> Result<(), ServiceError>;
}

impl<T: Topic> Tap for Subscriber<T> {
    fn topic(&self) -> &'static str {
        T::RULES.name
    }

    fn port(&self) -> &dyn Wakeable {
        self
    }

    fn drain(&self, gateway: &mut Gateway) -> Result<(), ServiceError> {
        while let Some(message) = self.receive()? {
            gateway.take::<T>(message.meta(), message.items());
        }
        Ok(())
    }
}

/// Listens to every topic that viewers are shown something of, in the order of the data flow.
fn open_taps(participant: &Participant) -> Result<Vec<Box<dyn Tap>>, PortError> {
    let mut taps: Vec<Box<dyn Tap>> = Vec::new();
    macro_rules! tap {
        ($topic:ty) => {
            if TOPICS.contains(&<$topic as Topic>::RULES.name) {
                taps.push(Box::new(participant.subscriber::<$topic>()?));
            }
        };
    }
    for_each_topic!(tap);
    Ok(taps)
}

#[cfg(test)]
#[path = "service_tests.rs"]
mod tests;
