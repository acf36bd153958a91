//! Which of our methods stands against which of a peer's: a speed bought by a worse pose does not count.

use super::data::Accuracy;
use crate::Summary;

/// Time and error of one method.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Entry {
    pub method: String,
    pub time: Summary,
    pub translation_error_m: f64,
    /// `None` where the true rotation is not known.
    pub rotation_error_deg: Option<f64>,
}

/// The method of ours that stands against one of a peer's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Choice<'a> {
    pub ours: &'a Entry,
    /// Whether ours is as accurate as the peer's, or more. If not, no method of ours is, and the ratio does not count.
    pub same_accuracy: bool,
}

/// The fastest of ours among those at least as accurate as the peer's; where there is none, the one that comes nearest
/// to it. Errors below the accuracy of the truth are alike.
pub(super) fn choose<'a>(ours: &'a [Entry], peer: &Entry, truth: Accuracy) -> Option<Choice<'a>> {
    let accurate = ours.iter().filter(|entry| excess(entry, peer, truth) <= 1.0);
    if let Some(ours) = fastest(accurate) {
        return Some(Choice { ours, same_accuracy: true });
    }
    let excess = |entry: &&Entry| excess(entry, peer, truth);
    let nearest = ours.iter().min_by(|a, b| excess(a).total_cmp(&excess(b)))?;
    Some(Choice { ours: nearest, same_accuracy: false })
}

/// The fastest by the median.
pub(super) fn fastest<'a>(entries: impl Iterator<Item = &'a Entry>) -> Option<&'a Entry> {
    entries.min_by(|a, b| a.time.p50.total_cmp(&b.time.p50))
}

/// How many times our errors are those of the peer, the worse of translation and rotation: 1 or less is as accurate.
fn excess(ours: &Entry, peer: &Entry, truth: Accuracy) -> f64 {
    let times = |ours: f64, peer: f64, truth: f64| if ours <= peer.max(truth) { 1.0 } else { ours / peer.max(truth) };
    let translation = times(ours.translation_error_m, peer.translation_error_m, truth.translation_m);
    match (ours.rotation_error_deg, peer.rotation_error_deg, truth.rotation_deg) {
        (Some(ours), Some(peer), Some(truth)) => translation.max(times(ours, peer, truth)),
        _ => translation,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(method: &str, ms: f64, metres: f64, degrees: f64) -> Entry {
        let time = Summary::single(ms);
        Entry { method: method.into(), time, translation_error_m: metres, rotation_error_deg: Some(degrees) }
    }

    const EXACT: Accuracy = Accuracy { translation_m: 0.0, rotation_deg: Some(0.0) };

    #[test]
    fn a_faster_method_with_a_worse_pose_does_not_count() {
        let ours =
            [entry("crude", 10.0, 0.01, 0.01), entry("turned", 20.0, 0.001, 0.5), entry("good", 60.0, 5e-4, 0.01)];
        let choice = choose(&ours, &entry("peer", 130.0, 6e-4, 0.02), EXACT).unwrap();
        assert_eq!((choice.ours.method.as_str(), choice.same_accuracy), ("good", true));
    }

    #[test]
    fn without_an_accurate_method_the_nearest_is_named_and_does_not_count() {
        let ours = [entry("crude", 10.0, 0.01, 0.01), entry("better", 60.0, 0.002, 0.01)];
        let choice = choose(&ours, &entry("peer", 130.0, 6e-4, 0.02), EXACT).unwrap();
        assert_eq!((choice.ours.method.as_str(), choice.same_accuracy), ("better", false));
        // A little nearer, but turned much farther.
        let ours = [entry("turned", 10.0, 0.0019, 0.9), entry("better", 60.0, 0.002, 0.01)];
        assert_eq!(choose(&ours, &entry("peer", 130.0, 6e-4, 0.02), EXACT).unwrap().ours.method, "better");
        assert_eq!(choose(&[], &entry("peer", 1.0, 1.0, 1.0), EXACT), None);
    }

    #[test]
    fn errors_below_the_accuracy_of_the_truth_are_alike() {
        let ours = [entry("fast", 10.0, 0.0079, 0.04), entry("slow", 20.0, 0.001, 0.001)];
        let truth = Accuracy { translation_m: 0.008, rotation_deg: Some(0.05) };
        assert_eq!(choose(&ours, &entry("peer", 30.0, 0.003, 0.01), truth).unwrap().ours.method, "fast");
        assert_eq!(choose(&ours, &entry("peer", 30.0, 0.003, 0.01), EXACT).unwrap().ours.method, "slow");
    }

    #[test]
    fn an_unknown_rotation_is_not_judged() {
        let ours = [entry("a", 10.0, 0.01, 9.0)];
        let truth = Accuracy { translation_m: 0.02, rotation_deg: None };
        assert!(choose(&ours, &entry("peer", 30.0, 0.003, 0.01), truth).unwrap().same_accuracy);
    }
}
