//! What a foreign registration has done so far, for whoever watches the graph.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use mirador_ipc_schema::messages::{Header, RegistrationStatus};
use mirador_ipc_schema::text;
use mirador_service_common::nanoseconds;

use super::fault::{FAULT_WORDS, Fault};

#[derive(Debug)]
struct Inner {
    newest: Header,
    status: RegistrationStatus,
    /// The last alignment was made by an answer.
    was_answered: bool,
}

/// Shared by the method, which counts, and the service, which tells.
#[derive(Debug, Clone)]
pub(crate) struct Tally {
    inner: Arc<Mutex<Inner>>,
    fallback: String,
}

impl Tally {
    pub fn new(fallback: &str) -> Self {
        let status = RegistrationStatus { fallback: text::pack(fallback), ..RegistrationStatus::default() };
        let inner = Inner { newest: Header::new(u64::MAX, 0), status, was_answered: false };
        Self { inner: Arc::new(Mutex::new(inner)), fallback: fallback.to_owned() }
    }

    /// This scan is aligned next.
    pub fn set_newest(&self, scan: Header) {
        self.lock().newest = scan;
    }

    /// A header that names a source scan: the newest has its own, of older ones only the id is known.
    pub fn header_of(&self, source_id: Option<u64>) -> Header {
        let newest = self.lock().newest;
        if source_id == Some(newest.id) { newest } else { Header::new(source_id.unwrap_or(u64::MAX), 0) }
    }

    /// An answer was taken.
    pub fn answered(&self, time: Duration) {
        let mut inner = self.lock();
        inner.was_answered = true;
        let status = &mut inner.status;
        status.questions += 1;
        status.answered += 1;
        status.last_answer_ns = nanoseconds(time);
        status.total_answer_ns += status.last_answer_ns;
        status.max_answer_ns = status.max_answer_ns.max(status.last_answer_ns);
    }

    /// The built-in method took the place of an answer.
    pub fn fell_back(&self, fault: &Fault) {
        let mut inner = self.lock();
        inner.was_answered = false;
        let status = &mut inner.status;
        status.questions += 1;
        status.fallbacks += 1;
        status.faults[fault.place()] += 1;
        if fault.place() != mirador_ipc_schema::messages::REGISTRATION_PAUSED {
            status.last_fault = text::pack(&fault.to_string());
        }
    }

    pub fn status(&self) -> RegistrationStatus {
        self.lock().status
    }

    /// The name of the method that the last alignment was made by.
    pub fn last_method(&self) -> &str {
        if self.lock().was_answered { super::NAME } else { &self.fallback }
    }

    /// How it is doing, in a line.
    pub fn words(&self) -> String {
        let status = self.status();
        if status.questions == 0 {
            return String::new();
        }
        let mut line = format!("external registration: {} of {} answered", status.answered, status.questions);
        if status.fallbacks > 0 {
            let counted = FAULT_WORDS.iter().zip(status.faults).filter(|(_, count)| *count > 0);
            let faults: Vec<String> = counted.map(|(word, count)| format!("{count} {word}")).collect();
            line = format!(
                "{line}, else {} ({}); last: {}",
                self.fallback,
                faults.join(", "),
                text::unpack(&status.last_fault)
            );
        }
        line
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
