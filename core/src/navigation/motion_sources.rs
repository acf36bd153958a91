//! Which of the references for the drives counts, as on the source's board (section 1): fixed priorities choose one; with
//! no valid reference the robot stops; an emergency button, a low battery or a lost link stops it, too.
//!
//! Pure: what is chosen follows from what was said before and the time asked about, nothing else.

use thiserror::Error;

/// A reference may be stamped this much ahead of the time it comes at [ns]: clocks differ, but a reference from the far
/// future would never end.
const AHEAD_NS: i64 = 1_000_000_000;

/// Who gives references, the first first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Source {
    /// The joystick on the robot's board, by wire.
    Board,
    /// The radio control, over a link.
    Radio,
    /// The operator's computer, over a link.
    Operator,
    /// The robot's own navigation.
    Navigation,
}

impl Source {
    /// All, by priority.
    pub const ALL: [Self; 4] = [Self::Board, Self::Radio, Self::Operator, Self::Navigation];

    /// Whether its references come over a link that can be lost.
    #[must_use]
    pub fn is_linked(self) -> bool {
        matches!(self, Self::Radio | Self::Operator)
    }

    /// Its name in words.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Board => "board",
            Self::Radio => "radio",
            Self::Operator => "operator",
            Self::Navigation => "navigation",
        }
    }
}

/// A reference for the drives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reference {
    /// When it was given [ns].
    pub stamp_ns: i64,
    /// It ends this long after [ns]. 0 signs the source off: it does not want to drive any more.
    pub valid_ns: u64,
    /// Forward speed [m/s].
    pub linear: f64,
    /// Turning speed about z [rad/s].
    pub angular: f64,
}

impl Reference {
    /// Whether it holds at a time.
    fn is_valid(&self, now_ns: i64) -> bool {
        let end = self.stamp_ns.saturating_add(i64::try_from(self.valid_ns).unwrap_or(i64::MAX));
        now_ns < end
    }
}

/// Why a reference is not taken.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum Refusal {
    /// A speed is not a number.
    #[error("its speeds {linear} m/s and {angular} rad/s are not finite")]
    NotFinite {
        /// Forward speed [m/s].
        linear: f64,
        /// Turning speed [rad/s].
        angular: f64,
    },
    /// It is stamped far ahead of now.
    #[error("it is stamped {ahead_ns} ns ahead of now")]
    FromTheFuture {
        /// How far [ns].
        ahead_ns: i64,
    },
    /// The source has given a later one already.
    #[error("it is older than the last one of its source")]
    OutOfOrder,
}

/// What stops the robot beside the sources.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Conditions {
    /// The battery is so low that the robot must stop.
    pub battery_low: bool,
    /// The robot lies on its side.
    pub tipped: bool,
}

/// Why the robot is to stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standstill {
    /// The emergency stop is pressed, or was and has not been released.
    Emergency,
    /// The robot lies on its side.
    Tipped,
    /// The battery is low.
    BatteryLow,
    /// The link to the source that drove is lost; it speaks again, or signs off, before another one drives.
    LinkLost(Source),
    /// No source has a valid reference.
    NoReference,
}

/// What the drives are to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Arbitration {
    /// Follow this source.
    Drive {
        /// Which.
        source: Source,
        /// Forward speed [m/s].
        linear: f64,
        /// Turning speed about z [rad/s].
        angular: f64,
    },
    /// Stand.
    Stand(Standstill),
}

/// The references of all sources.
#[derive(Debug, Clone, Default)]
pub struct MotionSources {
    references: [Option<Reference>; 4],
    is_stopped: bool,
    /// The linked source that drove last and has not signed off since.
    linked: Option<Source>,
}

impl MotionSources {
    /// Takes a reference of a source at a time.
    ///
    /// # Errors
    /// When it is not taken; what the source said before still holds.
    pub fn give(&mut self, source: Source, reference: Reference, now_ns: i64) -> Result<(), Refusal> {
        let Reference { linear, angular, stamp_ns, .. } = reference;
        if !(linear.is_finite() && angular.is_finite()) {
            return Err(Refusal::NotFinite { linear, angular });
        }
        let ahead_ns = stamp_ns.saturating_sub(now_ns);
        if ahead_ns > AHEAD_NS {
            return Err(Refusal::FromTheFuture { ahead_ns });
        }
        let last = &mut self.references[source as usize];
        if last.is_some_and(|last| stamp_ns < last.stamp_ns) {
            return Err(Refusal::OutOfOrder);
        }
        *last = Some(reference);
        if reference.valid_ns == 0 && self.linked == Some(source) {
            self.linked = None;
        }
        Ok(())
    }

    /// The emergency stop is pressed. It stays so until it is released, whoever says what meanwhile.
    pub fn press_emergency_stop(&mut self) {
        self.is_stopped = true;
    }

    /// The emergency stop is released. What was said before no longer counts: the robot moves only when somebody says so
    /// anew.
    pub fn release_emergency_stop(&mut self) {
        if self.is_stopped {
            *self = Self::default();
        }
    }

    /// Whether the emergency stop holds.
    #[must_use]
    pub fn is_stopped(&self) -> bool {
        self.is_stopped
    }

    /// What the drives are to do at a time. Times that are asked about must not go back.
    pub fn decide(&mut self, now_ns: i64, conditions: Conditions) -> Arbitration {
        let stand = |why| Arbitration::Stand(why);
        let chosen = Source::ALL.into_iter().find_map(|source| {
            let reference = self.references[source as usize].filter(|reference| reference.is_valid(now_ns))?;
            Some((source, reference))
        });
        // A source before the one whose link is lost may take over, one behind it may not.
        if let Some(linked) = self.linked
            && chosen.is_none_or(|(source, _)| source > linked)
        {
            return stand(self.hindrance(conditions).unwrap_or(Standstill::LinkLost(linked)));
        }
        if let Some((source, _)) = chosen {
            self.linked = source.is_linked().then_some(source);
        }
        match (self.hindrance(conditions), chosen) {
            (Some(why), _) => stand(why),
            (None, None) => stand(Standstill::NoReference),
            (None, Some((source, Reference { linear, angular, .. }))) => Arbitration::Drive { source, linear, angular },
        }
    }

    fn hindrance(&self, conditions: Conditions) -> Option<Standstill> {
        if self.is_stopped {
            Some(Standstill::Emergency)
        } else if conditions.tipped {
            Some(Standstill::Tipped)
        } else {
            conditions.battery_low.then_some(Standstill::BatteryLow)
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn reference(stamp_ns: i64, valid_ns: u64) -> Reference {
        Reference { stamp_ns, valid_ns, linear: 0.5, angular: 0.1 }
    }

    fn source_of(decision: Arbitration) -> Option<Source> {
        match decision {
            Arbitration::Drive { source, .. } => Some(source),
            Arbitration::Stand(_) => None,
        }
    }

    #[test]
    fn without_a_reference_the_robot_stands_and_with_one_it_drives_until_that_ends() {
        let mut sources = MotionSources::default();
        assert_eq!(sources.decide(0, Conditions::default()), Arbitration::Stand(Standstill::NoReference));
        sources.give(Source::Navigation, reference(10, 5), 10).unwrap();
        assert_eq!(source_of(sources.decide(14, Conditions::default())), Some(Source::Navigation));
        assert_eq!(sources.decide(15, Conditions::default()), Arbitration::Stand(Standstill::NoReference));
    }

    #[test]
    fn a_released_emergency_stop_waits_for_somebody_to_speak_anew() {
        let mut sources = MotionSources::default();
        sources.give(Source::Navigation, reference(0, 100), 0).unwrap();
        sources.press_emergency_stop();
        assert_eq!(sources.decide(1, Conditions::default()), Arbitration::Stand(Standstill::Emergency));
        sources.give(Source::Navigation, reference(2, 100), 2).unwrap();
        sources.release_emergency_stop();
        assert_eq!(sources.decide(3, Conditions::default()), Arbitration::Stand(Standstill::NoReference));
        sources.give(Source::Navigation, reference(4, 100), 4).unwrap();
        assert_eq!(source_of(sources.decide(5, Conditions::default())), Some(Source::Navigation));
    }

    #[test]
    fn a_lost_link_stops_the_robot_until_it_is_back_or_has_signed_off() {
        let mut sources = MotionSources::default();
        sources.give(Source::Radio, reference(0, 10), 0).unwrap();
        sources.give(Source::Navigation, reference(0, 1000), 0).unwrap();
        assert_eq!(source_of(sources.decide(5, Conditions::default())), Some(Source::Radio));
        let lost = Arbitration::Stand(Standstill::LinkLost(Source::Radio));
        assert_eq!(sources.decide(20, Conditions::default()), lost);
        sources.give(Source::Board, reference(21, 10), 21).unwrap();
        assert_eq!(source_of(sources.decide(22, Conditions::default())), Some(Source::Board), "it comes before");
        sources.give(Source::Radio, reference(40, 10), 40).unwrap();
        assert_eq!(source_of(sources.decide(41, Conditions::default())), Some(Source::Radio), "it is back");
        sources.give(Source::Radio, reference(42, 0), 42).unwrap();
        assert_eq!(source_of(sources.decide(43, Conditions::default())), Some(Source::Navigation), "it signed off");
    }

    #[test]
    fn bad_references_are_refused_and_change_nothing() {
        let mut sources = MotionSources::default();
        sources.give(Source::Navigation, reference(100, 50), 100).unwrap();
        let nan = Reference { linear: f64::NAN, ..reference(101, 50) };
        let refusals = [
            sources.give(Source::Navigation, nan, 101).unwrap_err().to_string(),
            sources.give(Source::Navigation, reference(i64::MAX, 50), 101).unwrap_err().to_string(),
            sources.give(Source::Navigation, reference(99, 500), 101).unwrap_err().to_string(),
        ];
        assert!(refusals[0].contains("not finite") && refusals[1].contains("ahead") && refusals[2].contains("older"));
        assert_eq!(
            sources.decide(149, Conditions::default()),
            Arbitration::Drive { source: Source::Navigation, linear: 0.5, angular: 0.1 }
        );
        assert_eq!(source_of(sources.decide(150, Conditions::default())), None);
    }

    fn given() -> impl Strategy<Value = (usize, i64, u64, f64, f64)> {
        (0..4_usize, 0..1000_i64, 0..500_u64, -2.0..2.0, -2.0..2.0)
    }

    proptest! {
        #[test]
        fn whoever_drives_is_valid_and_nobody_valid_comes_before_him(
            said in proptest::collection::vec(given(), 0..40), now in 0..1500_i64,
        ) {
            let mut sources = MotionSources::default();
            let mut newest: [Option<Reference>; 4] = [None; 4];
            for (source, stamp_ns, valid_ns, linear, angular) in said {
                let reference = Reference { stamp_ns, valid_ns, linear, angular };
                if sources.give(Source::ALL[source], reference, now).is_ok() {
                    newest[source] = Some(reference);
                }
            }
            let valid = |source: Source| newest[source as usize].is_some_and(|r| r.stamp_ns + r.valid_ns as i64 > now);
            let first = Source::ALL.into_iter().find(|source| valid(*source));
            let decision = sources.decide(now, Conditions::default());
            prop_assert_eq!(source_of(decision), first);
            if let (Arbitration::Drive { source, linear, angular }, Some(_)) = (decision, first) {
                let reference = newest[source as usize].unwrap();
                prop_assert_eq!((linear, angular), (reference.linear, reference.angular));
            }
        }

        #[test]
        fn the_robot_stands_whatever_is_said_while_something_stops_it(
            said in proptest::collection::vec(given(), 0..20), which in 0..3, now in 0..1500_i64,
        ) {
            let mut sources = MotionSources::default();
            let conditions = Conditions { battery_low: which == 0, tipped: which == 1 };
            if which == 2 {
                sources.press_emergency_stop();
            }
            for (source, stamp_ns, valid_ns, linear, angular) in said {
                let _ = sources.give(Source::ALL[source], Reference { stamp_ns, valid_ns, linear, angular }, now);
                prop_assert_eq!(source_of(sources.decide(now, conditions)), None);
            }
        }

        #[test]
        fn a_source_behind_a_lost_link_never_drives(
            steps in proptest::collection::vec((given(), any::<bool>()), 1..60),
        ) {
            let mut sources = MotionSources::default();
            let (mut now, mut driving) = (0, None);
            for ((source, _, valid_ns, linear, angular), asked) in steps {
                now += 50;
                let source = Source::ALL[source];
                sources.give(source, Reference { stamp_ns: now, valid_ns, linear, angular }, now).unwrap();
                if valid_ns == 0 && driving == Some(source) {
                    driving = None;
                }
                if asked && let Some(chosen) = source_of(sources.decide(now, Conditions::default())) {
                    prop_assert!(driving.is_none_or(|linked: Source| chosen <= linked), "{chosen:?} {driving:?}");
                    driving = chosen.is_linked().then_some(chosen);
                }
            }
        }
    }
}
