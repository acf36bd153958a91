//! What is heard of a foreign registration, added up over the incarnations of alignment.

use mirador_ipc_schema::messages::RegistrationStatus;

use crate::outputs::RegistrationTotals;

/// The counters so far.
#[derive(Debug, Default)]
pub struct RegistrationTally {
    incarnation: u32,
    now: Option<RegistrationStatus>,
    /// What earlier incarnations had counted.
    before: RegistrationTotals,
}

impl RegistrationTally {
    /// Takes in a report.
    pub fn take_in(&mut self, incarnation: u32, status: &RegistrationStatus) {
        if self.incarnation != incarnation {
            self.before = self.totals().unwrap_or_default();
            self.incarnation = incarnation;
        }
        self.now = Some(*status);
    }

    /// The sums; `None` while nothing was reported.
    pub fn totals(&self) -> Option<RegistrationTotals> {
        self.now.as_ref().map(|status| self.before.plus(status))
    }
}

#[cfg(test)]
mod tests {
    use mirador_ipc_schema::messages::REGISTRATION_LATE;

    use super::*;

    #[test]
    fn a_restarted_alignment_counts_on() {
        let mut tally = RegistrationTally::default();
        assert_eq!(tally.totals(), None);
        let mut status =
            RegistrationStatus { questions: 5, answered: 4, fallbacks: 1, ..RegistrationStatus::default() };
        (status.faults[REGISTRATION_LATE], status.total_answer_ns, status.max_answer_ns) = (1, 4_000_000, 3_000_000);
        tally.take_in(0, &status);
        tally.take_in(0, &RegistrationStatus { questions: 6, answered: 5, total_answer_ns: 5_000_000, ..status });
        tally.take_in(
            1,
            &RegistrationStatus { questions: 1, answered: 0, total_answer_ns: 0, max_answer_ns: 0, ..status },
        );
        let totals = tally.totals().unwrap();
        assert_eq!((totals.questions, totals.answered, totals.fallbacks, totals.faults["late"]), (7, 5, 2, 2));
        assert_eq!((totals.mean_answer_ms, totals.max_answer_ms), (Some(1.0), Some(3.0)));
    }
}
