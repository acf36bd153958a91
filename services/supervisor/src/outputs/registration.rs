//! How a foreign registration did, as it stands in `summary.json` and in `mirador top`.

use std::collections::BTreeMap;
use std::fmt;

use mirador_alignment::FAULT_WORDS;
use mirador_ipc_schema::messages::RegistrationStatus;
use mirador_ipc_schema::text;
use serde::Serialize;

/// How a foreign registration did.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct RegistrationTotals {
    /// The built-in method that takes its place.
    pub fallback: String,
    /// Alignments that were to be made.
    pub questions: u64,
    /// Of these, those by an answer.
    pub answered: u64,
    /// Of these, those by the built-in method.
    pub fallbacks: u64,
    /// Why: the number of each kind of fault.
    pub faults: BTreeMap<&'static str, u64>,
    /// Mean time from request to answer [ms]; `None` while there was no answer.
    pub mean_answer_ms: Option<f64>,
    /// The longest [ms].
    pub max_answer_ms: Option<f64>,
    /// The last fault in words; `None` while there was none.
    pub last_fault: Option<String>,
    #[serde(skip)]
    answer_ns: (u64, u64),
}

impl RegistrationTotals {
    /// These and what a later incarnation of alignment has counted.
    #[must_use]
    pub fn plus(&self, status: &RegistrationStatus) -> Self {
        let answered = self.answered + status.answered;
        let (total, most) = (self.answer_ns.0 + status.total_answer_ns, self.answer_ns.1.max(status.max_answer_ns));
        let counted = FAULT_WORDS.iter().zip(status.faults);
        let faults = counted.map(|(word, count)| (*word, count + self.faults.get(word).copied().unwrap_or(0)));
        let milliseconds = |ns: f64| (answered > 0).then_some(ns * 1e-6);
        let last = text::unpack(&status.last_fault);
        Self {
            fallback: text::unpack(&status.fallback).to_owned(),
            questions: self.questions + status.questions,
            answered,
            fallbacks: self.fallbacks + status.fallbacks,
            faults: faults.collect(),
            mean_answer_ms: milliseconds(total as f64 / answered as f64),
            max_answer_ms: milliseconds(most as f64),
            last_fault: if last.is_empty() { self.last_fault.clone() } else { Some(last.to_owned()) },
            answer_ns: (total, most),
        }
    }
}

impl fmt::Display for RegistrationTotals {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "external registration: {} of {} answered", self.answered, self.questions)?;
        if let (Some(mean), Some(most)) = (self.mean_answer_ms, self.max_answer_ms) {
            write!(f, " in {mean:.1} ms, {most:.1} ms at most")?;
        }
        if self.fallbacks == 0 {
            return Ok(());
        }
        let faults = self.faults.iter().filter(|(_, count)| **count > 0);
        let faults: Vec<String> = faults.map(|(word, count)| format!("{count} {}", word.replace('_', " "))).collect();
        write!(f, "; {} by {}: {}", self.fallbacks, self.fallback, faults.join(", "))?;
        self.last_fault.as_ref().map_or(Ok(()), |fault| write!(f, "; last: {fault}"))
    }
}
