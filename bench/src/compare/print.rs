//! The comparison as text.

use std::io::{self, Write};

use super::verdict::named;
use super::{Compared, Comparison, Verdict};
use crate::report::{number, print_aligned};

/// Prints what became slower and faster, and how much was alike or not judged and why.
///
/// # Errors
/// When `out` cannot be written.
pub fn print(comparison: &Comparison, out: &mut dyn Write) -> io::Result<()> {
    let (old, new) = (&comparison.old, &comparison.new);
    writeln!(
        out,
        "{}: {} (commit {}) -> {} (commit {})",
        comparison.bench,
        old.file.display(),
        old.machine.commit,
        new.file.display(),
        new.machine.commit
    )?;
    if !comparison.machine_differs.is_empty() {
        writeln!(out, "\nDIFFERENT MACHINES: what follows compares the machines as much as the programs")?;
        for difference in &comparison.machine_differs {
            writeln!(out, "  {difference}")?;
        }
    }
    for (verdict, word) in [(Verdict::Slower, "slower"), (Verdict::Faster, "faster")] {
        let rows: Vec<&Compared> = comparison.of(verdict).collect();
        if !rows.is_empty() {
            writeln!(out, "\n{word}")?;
            print_aligned(out, &table(&rows, verdict, 1.0 - comparison.options.alpha))?;
        }
    }
    if !comparison.drifts.is_empty() {
        writeln!(out, "\nlarger errors (shown, not tested)")?;
        for drift in &comparison.drifts {
            writeln!(out, "  {}: {} {} -> {}", drift.row, drift.figure, number(drift.old), number(drift.new))?;
        }
    }
    only(out, "only in the old report", &comparison.only_old)?;
    only(out, "only in the new report", &comparison.only_new)?;
    summing_up(comparison, out)
}

fn table(rows: &[&Compared], verdict: Verdict, confidence: f64) -> Vec<Vec<String>> {
    let interval = format!("{} % interval", number(100.0 * confidence).trim_end_matches('0').trim_end_matches('.'));
    let head = ["old p50", "new p50", "unit", "times", &interval, "p", "old p99", "new p99", "row"].map(String::from);
    let mut lines = vec![head.to_vec()];
    for row in rows {
        let Some(change) = row.change else { continue };
        let p = if verdict == Verdict::Slower { change.p_slower } else { change.p_faster };
        lines.push(vec![
            number(row.old_p50),
            number(row.new_p50),
            row.unit.clone(),
            number(change.ratio),
            format!("{} to {}", number(change.interval[0]), number(change.interval[1])),
            if p < 1e-4 { "< 0.0001".into() } else { number(p) },
            number(row.p99[0]),
            number(row.p99[1]),
            named(&row.name, &row.params),
        ]);
    }
    lines
}

fn only(out: &mut dyn Write, what: &str, rows: &[String]) -> io::Result<()> {
    if !rows.is_empty() {
        writeln!(out, "\n{what}")?;
        for row in rows {
            writeln!(out, "  {row}")?;
        }
    }
    Ok(())
}

fn summing_up(comparison: &Comparison, out: &mut dyn Write) -> io::Result<()> {
    let count = |verdict| comparison.of(verdict).count();
    let options = comparison.options;
    writeln!(
        out,
        "\n{} slower, {} faster, {} alike, {} not judged (changes above {} %, chance of a false alarm at most {} %)",
        count(Verdict::Slower),
        count(Verdict::Faster),
        count(Verdict::Alike),
        count(Verdict::NotJudged),
        number(100.0 * options.threshold),
        number(100.0 * options.alpha)
    )?;
    let mut reasons: Vec<String> = Vec::new();
    for row in comparison.of(Verdict::NotJudged) {
        let Some(reason) = row.reason.map(|reason| reason.to_string()) else { continue };
        if !reasons.contains(&reason) {
            reasons.push(reason);
        }
    }
    if !reasons.is_empty() {
        writeln!(out, "not judged because: {}", reasons.join("; "))?;
    }
    Ok(())
}
