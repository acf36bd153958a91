//! The comparison in short: ours against the peers' fastest.

use std::io::{self, Write};

use serde_json::Value;

use crate::BenchReport;
use crate::report::{number, print_aligned};

/// Prints, for each pair and number of threads, our fastest method at the same accuracy or better beside the fastest of
/// the peers. Nothing when no peer was measured.
///
/// # Errors
/// When `out` cannot be written.
pub fn print_comparison(report: &BenchReport, out: &mut dyn Write) -> io::Result<()> {
    let head =
        ["data", "threads", "ours", "ms", "error m", "deg", "peer", "ms", "error m", "deg", "ratio"].map(String::from);
    let mut lines = vec![head.to_vec()];
    for row in report.rows.iter().filter(|row| row.name == "pair_ratio") {
        let extra = |key: &str| row.extra.get(key).unwrap_or(&Value::Null);
        if extra("fastest_peer") != &Value::Bool(true) {
            continue;
        }
        let word = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        let figure = |value: &Value| value.as_f64().map_or_else(|| "-".into(), number);
        let param = |key: &str| word(row.params.get(key).unwrap_or(&Value::Null));
        let ratio = match extra("same_accuracy") {
            Value::Bool(true) => number(row.summary.p50),
            _ => "less accurate".into(),
        };
        lines.push(vec![
            param("data"),
            param("threads"),
            word(extra("method")),
            figure(extra("ours_ms")),
            figure(extra("translation_error_m")),
            figure(extra("rotation_error_deg")),
            param("peer_method"),
            figure(extra("peer_ms")),
            figure(extra("peer_translation_error_m")),
            figure(extra("peer_rotation_error_deg")),
            ratio,
        ]);
    }
    if lines.len() > 1 {
        writeln!(out, "\nour fastest method at the same accuracy or better, beside the peers' fastest (medians)")?;
        print_aligned(out, &lines)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use serde_json::json;

    use super::*;
    use crate::{Machine, Provenance, Row, Summary};

    fn report(same_accuracy: bool, fastest_peer: bool) -> BenchReport {
        let extra = json!({"method": "gicp", "same_accuracy": same_accuracy, "fastest_peer": fastest_peer,
                           "ours_ms": 50.0, "peer_ms": 100.0, "translation_error_m": 0.0004,
                           "rotation_error_deg": 0.5, "peer_translation_error_m": 0.02, "peer_rotation_error_deg": null});
        let params = json!({"data": "d", "threads": 2, "peer_method": "p VGICP"});
        let map = |value: Value| serde_json::from_value::<BTreeMap<String, Value>>(value).unwrap();
        let row = Row {
            name: "pair_ratio".into(),
            params: map(params),
            unit: "1".into(),
            summary: Summary::single(0.5),
            provenance: Provenance::Measured,
            extra: map(extra),
        };
        let machine = Machine { cpu: "a".into(), cores: 2, os: "b".into(), commit: "c".into() };
        BenchReport { bench: "registration".into(), machine, rows: vec![row] }
    }

    fn printed(report: &BenchReport) -> String {
        let mut out = Vec::new();
        print_comparison(report, &mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn the_ratio_stands_beside_both_errors() {
        let text = printed(&report(true, true));
        let last: Vec<&str> = text.lines().last().unwrap().split_whitespace().collect();
        assert_eq!(last, ["d", "2", "gicp", "50.0", "0.00040", "0.50", "p", "VGICP", "100", "0.020", "-", "0.50"]);
    }

    #[test]
    fn a_less_accurate_pose_has_no_ratio() {
        assert!(printed(&report(false, true)).trim_end().ends_with("less accurate"));
    }

    #[test]
    fn only_the_fastest_peer_is_shown() {
        assert_eq!(printed(&report(true, false)), "");
    }
}
