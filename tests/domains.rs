//! Two graphs on one host do not see each other.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot be set up has failed")]

mod support;

use std::process::Stdio;

use support::outputs::assert_same_bits;
use support::{Stage, assert_nothing_left, end_all, finish, new_domain, small_tour, summary};

#[test]
fn two_graphs_side_by_side_do_not_disturb_each_other() {
    let stage = Stage::new();
    let other = new_domain();
    let start = |domain, out: &str| {
        let mut arguments = vec!["--out".to_owned(), out.to_owned()];
        arguments.extend(small_tour());
        stage.mirador_in(domain, &arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    };
    let (one, two) = (start(stage.domain(), "one"), start(&other, "two"));
    let (one, two) = (finish(one), finish(two));
    end_all(&other);
    for finished in [&one, &two] {
        assert!(finished.status.success(), "{}\n{}", finished.stdout, finished.stderr);
        assert_eq!(finished.stderr, "");
    }
    for name in ["one", "two"] {
        let summary = summary(&stage.path(name));
        assert_eq!((&summary["scans"], &summary["aligned"]), (&8.into(), &8.into()), "{name}");
        assert_eq!((&summary["lost_messages"], &summary["restarts"]), (&0.into(), &0.into()), "{name}");
    }
    assert_same_bits(&stage.path("one"), &stage.path("two"));
    stage.assert_nothing_left();
    assert_nothing_left(&other);
}

#[test]
fn a_domain_that_is_in_use_is_refused_and_its_graph_goes_on() {
    let stage = Stage::new();
    let mut arguments = vec!["--out".to_owned(), "first".to_owned()];
    arguments.extend(small_tour());
    arguments.extend(["--set", "acquisition.rounds=4"].map(str::to_owned));
    let first = stage.mirador(&arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    support::eventually("the first graph is there", || stage.path("first/run.mcap").exists());
    let second = stage.run(&["tour", "--out", "second"]);
    assert_eq!(second.status.code(), Some(2), "{}", second.stderr);
    assert_eq!(second.stderr.trim_end().lines().count(), 1, "{}", second.stderr);
    assert!(second.stderr.contains("in use") && second.stderr.contains("--domain"), "{}", second.stderr);
    let first = finish(first);
    assert!(first.status.success(), "{}", first.stderr);
    let summary = summary(&stage.path("first"));
    assert_eq!((&summary["scans"], &summary["stop_reason"]), (&32.into(), &"input_ended".into()));
    assert_eq!((&summary["restarts"], &summary["lost_messages"]), (&0.into(), &0.into()));
    stage.assert_nothing_left();
}
