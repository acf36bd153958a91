//! The program of an external registration, running while `bench registration` measures it beside other methods.

use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use mirador_alignment::{EXTERNAL, ForeignRegistration};
use mirador_bench::registration::RegistrationBenchError;
use mirador_core::registration::Registration;
use mirador_ipc_schema::{Domain, StopSignal};
use mirador_service_common::ServiceError;

use crate::graph::{Graph, ServiceTables};
use crate::supervise::{Launch, Monitor, Seat, Supervised, last_line};
use crate::{Registry, UsageError};

/// Points of two keyframes at most: sizes the slots.
const MOST_POINTS: usize = 200_000;
/// Between two looks at whether the program lives.
const LOOK: Duration = Duration::from_millis(20);

/// The program, looked after by a thread of its own: it is started again as its rule says. It ends when this is dropped, and
/// leaves nothing.
pub struct ForeignProgram {
    /// The user wants no more.
    user: StopSignal,
    is_over: StopSignal,
    thread: Option<JoinHandle<()>>,
    /// Keeps every topic alive.
    _topics: Monitor,
    /// Given up last: with it goes what the program has left.
    seat: Seat,
}

impl ForeignProgram {
    /// Starts the program that the graph names for it, and waits until it answers.
    ///
    /// # Errors
    /// When the graph names none, or it does not come.
    pub fn start(graph: &Graph, threads: usize, registry: &Registry) -> Result<(Self, Box<dyn Registration>)> {
        let name = &graph.alignment.external.program;
        let entry = graph.programs.get(name).filter(|entry| !entry.command.is_empty()).ok_or_else(|| {
            let why = format!(
                "`{EXTERNAL}` is measured with a program: name it by --set 'programs.{name}.command=[\"...\"]'"
            );
            UsageError(why)
        })?;
        let domain = format!("bench-{:x}", std::process::id());
        let mut own = Graph { services: ServiceTables::default(), ..graph.clone() };
        (own.graph.domain, own.graph.max_points) = (domain.clone(), MOST_POINTS);
        let user = StopSignal::from_terminal().context("signals cannot be handled")?;
        let seat = Seat::take(&own, &user)?;
        let topics = Monitor::open(seat.participant()?)?;
        let run_dir = Domain::new(&domain)?.root().join("run");
        std::fs::create_dir_all(run_dir.join("logs"))
            .with_context(|| format!("{}: cannot be made", run_dir.display()))?;
        let launch = Launch {
            name: name.clone(),
            built_in: false,
            entry: entry.clone(),
            common: Vec::new(),
            run: 0,
            run_dir,
            domain,
            max_points: MOST_POINTS,
        };
        let log = launch.log_path();
        let mut program = Supervised::start(launch)?;
        let is_over = StopSignal::default();
        let until = is_over.clone();
        let look_after = move || {
            while !until.is_set() {
                if let Err(error) = program.look_after(&|| ()) {
                    tracing::error!("{error:#}");
                }
                std::thread::sleep(LOOK);
            }
        };
        let thread = std::thread::Builder::new().name("program".into()).spawn(look_after)?;
        let this = Self { user, is_over, thread: Some(thread), _topics: topics, seat };
        let method = ForeignRegistration::open(this.seat.participant()?, &graph.alignment, threads, registry);
        match method {
            Ok(method) => Ok((this, Box::new(method))),
            Err(ServiceError::Config(why)) => Err(UsageError(why).into()),
            Err(_) if this.is_stopped() => Err(RegistrationBenchError::Interrupted.into()),
            Err(error) => match last_line(&log) {
                Some(said) => Err(anyhow!("{error}; {name} said: {said}")),
                None => Err(error.into()),
            },
        }
    }

    /// Whether the user wants no more.
    pub fn is_stopped(&self) -> bool {
        self.user.is_set()
    }
}

impl Drop for ForeignProgram {
    fn drop(&mut self) {
        self.is_over.set();
        if let Some(thread) = self.thread.take() {
            // With the thread ends the program. A panic of it has been told of by the standard hook.
            let _ = thread.join();
        }
    }
}
