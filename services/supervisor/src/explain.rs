//! `mirador explain`: why every decision of a run was taken, from its recording.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use anyhow::Context;
use mirador_core::geometry::{Pose, pose_from_rows};
use mirador_ipc_schema::messages::{
    ALIGNMENT_ACCEPTED, ALIGNMENT_FIRST, AlignmentMeta, CANDIDATE_OPEN, CLOCK_ENDED, CLOCK_FAULT, CandidateView,
    DECISION_STOP, Hypothesis, LoopClosingMeta, PAIR_ACCEPTED, PAIR_LOOP, PAIR_REJECTED, PAIR_SWITCHED_OFF,
    PAIR_SWITCHED_ON, ScanId, ScanPair, ViewPlanMeta,
};
use mirador_ipc_schema::{text, topics};
use mirador_recorder::{RUN_FILE, RunReader};

/// Prints how every scan was aligned and what was decided after it; only for `scan` when one is given.
///
/// # Errors
/// When `run_dir` holds no readable recording or the recording no such scan, and when `out` cannot be written.
pub fn explain(run_dir: &Path, scan: Option<u32>, out: &mut dyn Write) -> anyhow::Result<()> {
    let path = run_dir.join(RUN_FILE);
    anyhow::ensure!(
        path.is_file(),
        "'{}' has no {RUN_FILE}: name the output folder of a run, such as ./mirador-out",
        run_dir.display()
    );
    let mut reader = RunReader::open(&path)?;
    let mut scans = reader.scan_index();
    scans.sort_unstable();
    scans.dedup();
    if let Some(wanted) = scan {
        if !scans.contains(&wanted) {
            return Err(reader.no_scan(wanted).into());
        }
        scans = vec![wanted];
    }
    if !reader.is_complete() {
        writeln!(out, "The recording was cut off; this is what was saved of it.\n")?;
    }
    let (mut hypotheses, mut candidates, mut pairs) = (Vec::new(), Vec::new(), Vec::new());
    for &scan in &scans {
        writeln!(out, "Scan {scan}")?;
        let alignment = reader.read_about::<topics::Alignment>(scan, &mut hypotheses)?;
        explain_alignment(alignment.as_ref(), &hypotheses, out).context("cannot print the explanation")?;
        let loops = reader.read_about::<topics::LoopClosing>(scan, &mut pairs)?;
        explain_loops(loops.as_ref(), &pairs, out).context("cannot print the explanation")?;
        let plan = reader.read_about::<topics::ViewPlan>(scan, &mut candidates)?;
        explain_plan(plan.as_ref(), &candidates, out).context("cannot print the explanation")?;
        writeln!(out)?;
    }
    if scan.is_none() {
        explain_end(&mut reader, scans.len(), out)?;
    }
    Ok(())
}

/// How the source of the scans ended: a stop is decided after every scan, but recorded scans go on all the same.
fn explain_end(reader: &mut RunReader, scans: usize, out: &mut dyn Write) -> anyhow::Result<()> {
    let mut state = None;
    reader.for_each_meta::<topics::Clock>(|clock, _| state = Some(clock.state))?;
    match state {
        Some(CLOCK_ENDED) => writeln!(out, "The input ended after {scans} scans.")?,
        Some(CLOCK_FAULT) => writeln!(out, "The source of the scans could not go on after {scans} scans.")?,
        _ => {}
    }
    Ok(())
}

fn explain_alignment(
    alignment: Option<&AlignmentMeta>,
    hypotheses: &[Hypothesis],
    out: &mut dyn Write,
) -> std::io::Result<()> {
    let Some(a) = alignment else { return writeln!(out, "  Alignment: none was recorded") };
    let method = text::unpack(&a.method);
    match a.status {
        ALIGNMENT_FIRST => writeln!(out, "  Alignment: the first scan, it defines the map")?,
        ALIGNMENT_ACCEPTED => writeln!(
            out,
            "  Alignment: accepted against scan {} by {method}: overlap {:.3}, residual {:.2} mm, {} iterations, {}",
            a.target_scan,
            a.overlap,
            1e3 * a.residual_m,
            a.iterations,
            constrained(a.constrained)
        )?,
        _ => writeln!(out, "  Alignment: NOT ALIGNED by {method}: {}", text::unpack(&a.reason))?,
    }
    let prior = if a.has_prior == 1 { place(&a.prior) } else { "none".to_owned() };
    writeln!(out, "    prior: {prior}")?;
    writeln!(out, "    pose:  {}", place(&a.map_from_scanner))?;
    for (k, h) in hypotheses.iter().enumerate() {
        let verdict = if h.accepted == 1 { "accepted" } else { text::unpack(&h.reason) };
        writeln!(
            out,
            "    hypothesis {k} from {}: overlap {:.3}, residual {:.2} mm, {} iterations: {verdict}",
            text::unpack(&h.origin),
            h.overlap,
            1e3 * h.residual_m,
            h.iterations
        )?;
        writeln!(out, "      start {}", place(&h.start))?;
        writeln!(out, "      found {}", place(&h.found))?;
    }
    Ok(())
}

/// What was done about older scans: every pair that was tried, and what moved. Old recordings have nothing of it.
fn explain_loops(loops: Option<&LoopClosingMeta>, pairs: &[ScanPair], out: &mut dyn Write) -> std::io::Result<()> {
    let Some(l) = loops else { return Ok(()) };
    if l.nodes == 0 {
        return writeln!(out, "  Older scans: not looked at");
    }
    writeln!(
        out,
        "  Older scans: {} within reach, {} pairs tried; {} pairs of {} scans in all, {} loops switched off",
        l.candidates,
        pairs.iter().filter(|p| p.status == PAIR_ACCEPTED || p.status == PAIR_REJECTED).count(),
        l.edges,
        l.nodes,
        l.switched_off
    )?;
    for pair in pairs {
        explain_pair(pair, out)?;
    }
    if l.free_nodes == 0 {
        return writeln!(out, "    no correction: every new pair agrees with the poses as they are");
    }
    writeln!(
        out,
        "    solved for {} poses: chi2 {:.2} before, {:.2} after {} iterations{}; {} poses corrected by up to {:.1} mm and {:.3}°",
        l.free_nodes,
        l.chi2_before,
        l.chi2_after,
        l.iterations,
        if l.converged == 1 { "" } else { ", NOT CONVERGED" },
        l.corrections,
        1e3 * l.largest_shift_m,
        l.largest_turn.to_degrees()
    )
}

fn explain_pair(p: &ScanPair, out: &mut dyn Write) -> std::io::Result<()> {
    let kind = if p.kind == PAIR_LOOP { "loop" } else { "overlap" };
    let target = ScanId::unpack(p.target_id).scan;
    match p.status {
        PAIR_SWITCHED_OFF | PAIR_SWITCHED_ON => {
            let (state, source) = (p.status == PAIR_SWITCHED_OFF, ScanId::unpack(p.source_id).scan);
            let word = if state { "SWITCHED OFF: it contradicts the rest" } else { "counts again" };
            return writeln!(out, "    loop of scans {target} and {source}: {word}");
        }
        _ => {}
    }
    let verdict = if p.status == PAIR_ACCEPTED { "accepted" } else { text::unpack(&p.reason) };
    writeln!(
        out,
        "    {kind} with scan {target} from {}: known to {:.3} m and {:.2}°, overlap {:.3} of {:.3} predicted, residual \
         {:.2} mm, {:.1} sigmas from the prediction, {} iterations: {verdict}",
        if p.is_coarse == 1 { "coarse alignment" } else { "the prediction" },
        p.predicted_sigma_m,
        p.predicted_sigma_rotation.to_degrees(),
        p.overlap,
        p.predicted_overlap,
        1e3 * p.residual_m,
        p.sigmas,
        p.iterations
    )?;
    writeln!(out, "      predicted {}", place(&p.predicted))?;
    writeln!(out, "      found     {}", place(&p.found))
}

/// How many directions of motion the geometry holds, in words. The bits stand for the pair's own principal directions,
/// not for the axes of a frame, so only their number can be told.
fn constrained(bits: u32) -> String {
    match bits.count_ones() {
        6 => "all directions constrained".into(),
        n => format!("{n} of 6 directions constrained"),
    }
}

/// A pose in one line: position and yaw, pitch, roll.
fn place(rows: &[f64; 16]) -> String {
    let Some(pose): Option<Pose> = pose_from_rows(rows) else { return "not a pose".to_owned() };
    let t = pose.translation;
    let (roll, pitch, yaw) = pose.rotation.euler_angles();
    format!(
        "({:.3}, {:.3}, {:.3}) m, yaw {:.2}° pitch {:.2}° roll {:.2}°",
        t.x,
        t.y,
        t.z,
        yaw.to_degrees(),
        pitch.to_degrees(),
        roll.to_degrees()
    )
}

pub(crate) fn explain_plan(
    plan: Option<&ViewPlanMeta>,
    candidates: &[CandidateView],
    out: &mut dyn Write,
) -> std::io::Result<()> {
    let Some(p) = plan else { return writeln!(out, "  Plan: none was recorded") };
    writeln!(
        out,
        "  Plan: strategy {} on map revision {}: {} known cells, {} navigable, mean quality {:.3} of {:.3} asked for, {} zones",
        text::unpack(&p.strategy),
        p.map_revision,
        p.cells_known,
        p.cells_navigable,
        p.mean_quality,
        p.quality_asked,
        p.zones
    )?;
    let [a, q, o, c] = p.weights;
    writeln!(out, "    weights: A {a}, Q {q}, O {o}, C {c}; stops below utility {:.4}", p.utility_threshold)?;
    valued(p, candidates, out)?;
    rejected(candidates, out)?;
    let (code, words) = (text::unpack(&p.reason_code), text::unpack(&p.reason));
    let chosen = usize::try_from(p.chosen).ok().and_then(|k| candidates.get(k));
    match (p.decision, chosen) {
        (DECISION_STOP, _) => writeln!(out, "    STOP: {words} ({code})"),
        (_, Some(view)) => writeln!(
            out,
            "    GO to candidate {} at ({:.2}, {:.2}), {:.2} m away on the path: {words} ({code})",
            p.chosen, view.position[0], view.position[1], p.path_length_m
        ),
        (_, None) => writeln!(out, "    no candidate chosen: {words} ({code})"),
    }
}

/// The candidates that were valued, best first.
fn valued(plan: &ViewPlanMeta, candidates: &[CandidateView], out: &mut dyn Write) -> std::io::Result<()> {
    let mut open: Vec<_> = candidates.iter().enumerate().filter(|(_, v)| v.status == CANDIDATE_OPEN).collect();
    open.sort_by(|(i, a), (k, b)| b.utility.total_cmp(&a.utility).then(i.cmp(k)));
    if open.is_empty() {
        return writeln!(out, "    no candidate was valued");
    }
    writeln!(
        out,
        "    {:>9} {:>18} {:>7} {:>7} {:>7} {:>8} {:>8} {:>10}",
        "candidate", "position [m]", "A", "Q", "O", "C", "u", "unexplored"
    )?;
    for (k, v) in open {
        let mark = if u32::try_from(k) == Ok(plan.chosen) { '>' } else { ' ' };
        let position = format!("({:.2}, {:.2})", v.position[0], v.position[1]);
        writeln!(
            out,
            "  {mark} {k:>9} {position:>18} {:>7.3} {:>7.3} {:>7.3} {:>8.3} {:>8.4} {:>10}",
            v.information, v.quality, v.zones, v.cost, v.utility, v.unexplored_cells
        )?;
    }
    Ok(())
}

/// The candidates that were not valued, by reason.
fn rejected(candidates: &[CandidateView], out: &mut dyn Write) -> std::io::Result<()> {
    let mut reasons: BTreeMap<(u32, &str), Vec<usize>> = BTreeMap::new();
    for (k, view) in candidates.iter().enumerate().filter(|(_, v)| v.status != CANDIDATE_OPEN) {
        reasons.entry((view.status, text::unpack(&view.reason))).or_default().push(k);
    }
    for ((_, reason), which) in reasons {
        // A few numbers are enough to look them up; thousands of them explain nothing.
        let mut shown: Vec<String> = which.iter().take(8).map(usize::to_string).collect();
        if which.len() > shown.len() {
            shown.push("...".to_owned());
        }
        writeln!(out, "    rejected, {reason}: {} ({})", which.len(), shown.join(", "))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outputs::testing::record_run;

    fn explained(scan: Option<u32>) -> String {
        let folder = tempfile::tempdir().unwrap();
        record_run(folder.path());
        let mut out = Vec::new();
        explain(folder.path(), scan, &mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn the_chosen_candidate_is_marked_and_the_best_comes_first() {
        let text = explained(Some(0));
        let rows: Vec<_> = text.lines().filter(|l| l.contains("(3.10, 4.00)") || l.contains("(-1.00, 2.00)")).collect();
        assert!(rows[0].starts_with("  >         1") && rows[0].contains("0.9000"), "{text}");
        assert!(rows[1].starts_with("            0") && rows[1].contains("0.2000"), "{text}");
        assert!(text.contains("GO to candidate 1 at (3.10, 4.00), 5.50 m away"), "{text}");
        assert!(text.contains("rejected, too near: 1 (2)"), "{text}");
        assert!(!text.contains("Scan 1"), "{text}");
    }

    #[test]
    fn a_stop_and_a_failed_alignment_are_told_in_words() {
        let text = explained(None);
        assert!(text.contains("Scan 0") && text.contains("Scan 1") && text.contains("Scan 2"));
        assert!(text.contains("the first scan, it defines the map"));
        assert!(text.contains("NOT ALIGNED by icp: overlap 0.10 is below 0.30"), "{text}");
        assert!(text.contains("STOP: the model is good enough (done)"), "{text}");
        assert!(text.contains("hypothesis 0 from prior: overlap 0.100"), "{text}");
        assert!(text.contains("12 iterations, 4 of 6 directions constrained"), "{text}");
    }

    #[test]
    fn every_loop_is_told_with_what_came_of_it() {
        let text = explained(Some(2));
        assert!(
            text.contains("Older scans: 2 within reach, 2 pairs tried; 4 pairs of 3 scans in all, 1 loops"),
            "{text}"
        );
        assert!(text.contains("loop with scan 0 from coarse alignment: known to 0.500 m"), "{text}");
        assert!(text.contains("12 iterations: accepted"), "{text}");
        assert!(
            text.contains("overlap with scan 1 from the prediction") && text.contains(": overlap 0.10 is below 0.40")
        );
        assert!(text.contains("loop of scans 0 and 1: SWITCHED OFF"), "{text}");
        assert!(
            text.contains("chi2 90.00 before, 4.50 after 3 iterations; 1 poses corrected by up to 100.0 mm"),
            "{text}"
        );
    }

    #[test]
    fn a_folder_without_a_recording_is_an_error_that_says_so() {
        let folder = tempfile::tempdir().unwrap();
        let error = explain(folder.path(), None, &mut Vec::new()).unwrap_err().to_string();
        assert!(error.contains("has no run.mcap") && error.contains("output folder"), "{error}");
    }

    #[test]
    fn a_scan_that_does_not_exist_is_an_error_that_names_those_that_do() {
        let folder = tempfile::tempdir().unwrap();
        record_run(folder.path());
        let error = explain(folder.path(), Some(9), &mut Vec::new()).unwrap_err().to_string();
        assert!(error.contains("no scan 9") && error.contains("3 scans from 0 to 2"), "{error}");
    }
}
