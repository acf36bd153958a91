//! The thread that takes in messages.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use mirador_ipc_schema::topics::{Alignment, Clock, RegistrationStatus, ServiceHealth, Topic, ViewPlan};
use mirador_ipc_schema::{Domain, Participant, Sizes, StopSignal, Subscriber, Wake, Wakeable};

use super::state::State;
use crate::commands::find::WATCHER;

/// The longest pause between two looks: reports of health come every 50 ms, and sixteen of them may wait.
const LOOK: Duration = Duration::from_millis(50);

/// A thread that takes in what a graph says.
pub(super) struct Listening {
    state: Arc<Mutex<State>>,
    finish: Arc<AtomicBool>,
    thread: JoinHandle<Result<()>>,
}

impl Listening {
    /// Joins the domain and begins to listen.
    ///
    /// # Errors
    /// When the domain cannot be joined or the health topic cannot be opened.
    pub(super) fn start(domain: Domain, stop: StopSignal) -> Result<Self> {
        let state = Arc::new(Mutex::new(State::default()));
        let finish = Arc::new(AtomicBool::new(false));
        let (opened, open) = mpsc::channel();
        let thread = std::thread::spawn({
            let (state, finish) = (Arc::clone(&state), Arc::clone(&finish));
            // Ports cannot move between threads, so they are opened where they are used.
            move || {
                let name = format!("{WATCHER}{}", std::process::id());
                let participant = Participant::join(domain, &name, 0, Sizes { scan_points: 1 }, Wake::Event, stop)?;
                let ears = Ears::open(&participant, &state)?;
                let _ = opened.send(());
                ears.listen(&participant, &state, &finish)
            }
        });
        if open.recv().is_ok() {
            return Ok(Self { state, finish, thread });
        }
        // It ended before it had opened its ports.
        Err(joined(thread).err().unwrap_or_else(|| anyhow!("the graph cannot be listened to")))
    }

    /// Looks at the state.
    pub(super) fn state<R>(&self, look: impl FnOnce(&State) -> R) -> R {
        look(&self.state.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Whether the thread has ended by itself.
    pub(super) fn has_ended(&self) -> bool {
        self.thread.is_finished()
    }

    /// Ends the thread, which leaves the domain.
    ///
    /// # Errors
    /// When a topic could not be read.
    pub(super) fn end(self) -> Result<()> {
        self.finish.store(true, Ordering::Relaxed);
        joined(self.thread)
    }
}

fn joined(thread: JoinHandle<Result<()>>) -> Result<()> {
    thread.join().map_err(|_| anyhow!("the listening thread panicked"))?
}

/// The topics that are listened to. All but the first are left out when they have no place for another reader.
struct Ears {
    health: Subscriber<ServiceHealth>,
    clock: Option<Subscriber<Clock>>,
    alignments: Option<Subscriber<Alignment>>,
    plans: Option<Subscriber<ViewPlan>>,
    registrations: Option<Subscriber<RegistrationStatus>>,
}

impl Ears {
    fn open(participant: &Participant, state: &Mutex<State>) -> Result<Self> {
        Ok(Self {
            health: participant.subscriber().context("health cannot be listened to")?,
            clock: open_if_free(participant, state),
            alignments: open_if_free(participant, state),
            plans: open_if_free(participant, state),
            registrations: open_if_free(participant, state),
        })
    }

    fn listen(&self, participant: &Participant, state: &Mutex<State>, finish: &AtomicBool) -> Result<()> {
        // Reports of health come all the time and have room to wait; they need not wake anyone.
        let waking: Vec<&dyn Wakeable> = [
            self.clock.as_ref().map(|s| s as &dyn Wakeable),
            self.alignments.as_ref().map(|s| s as &dyn Wakeable),
            self.plans.as_ref().map(|s| s as &dyn Wakeable),
        ]
        .into_iter()
        .flatten()
        .collect();
        while !participant.stop().is_set() && !finish.load(Ordering::Relaxed) {
            participant.wait(&waking, LOOK);
            self.health.drain_events();
            self.take_in(&mut state.lock().unwrap_or_else(PoisonError::into_inner))?;
        }
        Ok(())
    }

    fn take_in(&self, state: &mut State) -> Result<()> {
        while let Some(message) = self.health.receive()? {
            for health in message.items() {
                state.take_health(message.header(), health);
            }
        }
        if let Some(clock) = &self.clock {
            while let Some(message) = clock.receive()? {
                state.take_clock(message.meta());
            }
        }
        if let Some(alignments) = &self.alignments {
            while let Some(message) = alignments.receive()? {
                state.take_alignment(message.meta());
            }
        }
        if let Some(registrations) = &self.registrations {
            while let Some(message) = registrations.receive()? {
                for status in message.items() {
                    state.take_registration(message.header(), status);
                }
            }
        }
        if let Some(plans) = &self.plans {
            while let Some(message) = plans.receive()? {
                state.take_plan(message.meta(), message.items().len());
            }
        }
        Ok(())
    }
}

fn open_if_free<T: Topic>(participant: &Participant, state: &Mutex<State>) -> Option<Subscriber<T>> {
    match participant.subscriber() {
        Ok(subscriber) => Some(subscriber),
        Err(error) => {
            let note = format!("not shown: {error}");
            state.lock().unwrap_or_else(PoisonError::into_inner).add_note(note);
            None
        }
    }
}
