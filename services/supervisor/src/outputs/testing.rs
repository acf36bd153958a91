//! A run of three scans whose figures are computed by hand.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use mirador_core::geometry::{Pose, rows_from_pose};
use mirador_ipc_schema::messages::{
    ALIGNMENT_ACCEPTED, ALIGNMENT_FIRST, ALIGNMENT_REJECTED, AlignmentMeta, CandidateView, DECISION_GO, DECISION_STOP,
    Envelope, Header, Hypothesis, LoopClosingMeta, MapCell, MapMeta, MapTile, PAIR_LOOP, PAIR_REJECTED,
    PAIR_SWITCHED_OFF, PathMeta, Point, PointScore, PoseCorrection, ScanId, ScanMeta, ScanPair, ScoredScanMeta,
    ViewPlanMeta, Waypoint,
};
use mirador_ipc_schema::text::pack;
use mirador_ipc_schema::topics;
use mirador_recorder::{RUN_FILE, RecorderConfig, RunWriter};
use nalgebra::Vector3;

use super::run_data::RunData;
use super::{RunFacts, ServiceTotals};

const MS: u64 = 1_000_000;

fn header(scan: u32, after_ns: u64) -> Header {
    let id = ScanId { robot: 0, run: 1, scan }.pack();
    let sent_ns = u64::from(scan) * 1_000 * MS + 1_000 + after_ns;
    Header { id, stamp_ns: i64::from(scan) * 2_500_000_000 + 1, sent_ns, ..Header::default() }
}

/// Four returns on the corners of a square and one empty cell.
pub(crate) fn points() -> Vec<Point> {
    let point = |x, y| Point { x, y, z: 0.25, intensity: 7, time: 0 };
    let empty = Point { x: f32::NAN, y: f32::NAN, z: f32::NAN, ..Point::default() };
    vec![point(1.0, 0.0), point(0.0, 1.0), empty, point(-1.0, 0.0), point(0.0, -1.0)]
}

fn pose(x: f64, y: f64, yaw: f64) -> Pose {
    Pose::new(Vector3::new(x, y, 0.0), Vector3::new(0.0, 0.0, yaw))
}

/// The pose that alignment gives a scan; scan 1 is corrected later to (3, 4).
fn aligned_at(scan: u32) -> Pose {
    [pose(0.0, 0.0, 0.0), pose(3.0, 3.9, 0.0), pose(9.0, 9.0, 0.0)][scan as usize]
}

fn alignment(scan: u32) -> (AlignmentMeta, Vec<Hypothesis>) {
    let status = [ALIGNMENT_FIRST, ALIGNMENT_ACCEPTED, ALIGNMENT_REJECTED][scan as usize];
    let rows = rows_from_pose(&aligned_at(scan));
    let reason = if scan == 2 { "overlap 0.10 is below 0.30" } else { "" };
    let meta = AlignmentMeta {
        header: header(scan, 5 * MS),
        map_from_scanner: rows,
        prior: rows,
        has_prior: 1,
        overlap: if scan == 2 { 0.1 } else { 0.8 },
        residual_m: 0.004,
        prepare_ns: 3 * MS,
        align_ns: u64::from(scan) * MS,
        status,
        target_scan: scan.wrapping_sub(1),
        iterations: 12,
        constrained: 0b11_0011,
        method: pack("icp"),
        reason: pack(reason),
        ..AlignmentMeta::default()
    };
    let tried = Hypothesis {
        start: rows,
        found: rows,
        overlap: meta.overlap,
        residual_m: 0.004,
        iterations: 12,
        accepted: u32::from(scan == 1),
        origin: pack("prior"),
        reason: pack(reason),
    };
    (meta, if scan == 0 { Vec::new() } else { vec![tried] })
}

fn candidates() -> Vec<CandidateView> {
    let view = |x, y, utility, status, reason: &str| CandidateView {
        position: [x, y, 0.0],
        utility,
        information: 0.5,
        cost: 5.0,
        status,
        reason: pack(reason),
        ..CandidateView::default()
    };
    vec![view(-1.0, 2.0, 0.2, 0, ""), view(3.1, 4.0, 0.9, 0, ""), view(0.1, 0.0, 0.0, 3, "too near")]
}

fn plan(scan: u32) -> ViewPlanMeta {
    let stops = scan == 2;
    ViewPlanMeta {
        header: header(scan, (20 + u64::from(scan)) * MS),
        map_ns: 5 * MS,
        planning_ns: 6 * MS,
        weights: [1.0, 0.5, 0.25, 0.1],
        mean_quality: 0.4,
        decision: if stops { DECISION_STOP } else { DECISION_GO },
        chosen: if stops { u32::MAX } else { 1 },
        path_length_m: if stops { 0.0 } else { 5.5 },
        strategy: pack("next_best_view"),
        reason_code: pack(if stops { "done" } else { "best_utility" }),
        reason: pack(if stops { "the model is good enough" } else { "the highest utility" }),
        ..ViewPlanMeta::default()
    }
}

fn tile() -> MapTile {
    let mut tile = MapTile::default();
    tile.cells[0] = MapCell { navigability: 65535, quality: 65535, flags: 1, measured: 9, ..MapCell::default() };
    tile.cells[1] = MapCell { navigability: 0, quality: 0, flags: 1, measured: 9, ..MapCell::default() };
    tile
}

/// Two known cells of 0.5 m in a row at the origin.
pub(crate) fn map_data() -> RunData {
    let mut data = RunData::default();
    data.map.cell_m = 0.5;
    data.map.tiles.insert((0, 0), Box::new(tile()));
    data
}

/// Records the run into `folder`.
pub(crate) fn record_run(folder: &Path) {
    let mut writer = RunWriter::create(&folder.join(RUN_FILE), &RecorderConfig::default()).unwrap();
    for scan in 0..3 {
        let meta = ScanMeta {
            header: header(scan, 0),
            rows: 1,
            cols: 5,
            returns: 4,
            source_index: 10 + scan,
            ..ScanMeta::default()
        };
        writer.record::<topics::Scan>(&meta, &points()).unwrap();
        let (alignment, hypotheses) = alignment(scan);
        writer.record::<topics::Alignment>(&alignment, &hypotheses).unwrap();
        let scored = ScoredScanMeta {
            header: header(scan, 9 * MS),
            surface_ns: u64::from(scan + 1) * MS,
            analysis_ns: 2 * MS,
            ..ScoredScanMeta::default()
        };
        let mut scores = [PointScore { quality: 32768, flags: 1, ..PointScore::default() }; 5];
        scores[4].flags = 0;
        writer.record::<topics::ScoredScan>(&scored, &scores).unwrap();
        let map = MapMeta {
            header: header(scan, 12 * MS),
            cell_m: 0.5,
            cells_known: 2,
            mean_quality: 0.5,
            parts: 1,
            ..MapMeta::default()
        };
        writer.record::<topics::InformationMap>(&map, &[tile()]).unwrap();
        writer.record::<topics::ViewPlan>(&plan(scan), &candidates()).unwrap();
        if scan < 2 {
            let path = PathMeta { header: header(scan, 25 * MS), length_m: 5.5, ..PathMeta::default() };
            let waypoints = [[0.0, 0.0, 0.0], [3.1, 4.0, 0.0]].map(|position| Waypoint { position, navigability: 1.0 });
            writer.record::<topics::Path>(&path, &waypoints).unwrap();
        }
        writer.flush().unwrap();
    }
    let corrected = PoseCorrection {
        id: header(1, 0).id,
        map_from_scanner: rows_from_pose(&pose(3.0, 4.0, 0.0)),
        ..PoseCorrection::default()
    };
    writer.record::<topics::PoseCorrections>(&Envelope { header: header(2, 30 * MS) }, &[corrected]).unwrap();
    let (loops, pairs) = loops();
    writer.record::<topics::LoopClosing>(&loops, &pairs).unwrap();
    writer.finish().unwrap();
}

/// What was done about older scans after scan 2.
fn loops() -> (LoopClosingMeta, [ScanPair; 3]) {
    let loops = LoopClosingMeta {
        header: header(2, 30 * MS),
        chi2_before: 90.0,
        chi2_after: 4.5,
        largest_shift_m: 0.1,
        candidates: 2,
        nodes: 3,
        edges: 4,
        switched_off: 1,
        free_nodes: 2,
        iterations: 3,
        corrections: 1,
        converged: 1,
        ..LoopClosingMeta::default()
    };
    let here = rows_from_pose(&pose(1.0, 0.0, 0.0));
    let pair = |target: u32, source: u32| ScanPair {
        target_id: header(target, 0).id,
        source_id: header(source, 0).id,
        predicted: here,
        found: here,
        iterations: 12,
        ..ScanPair::default()
    };
    let closed = ScanPair { kind: PAIR_LOOP, is_coarse: 1, predicted_sigma_m: 0.5, ..pair(0, 2) };
    let rejected = ScanPair { status: PAIR_REJECTED, reason: pack("overlap 0.10 is below 0.40"), ..pair(1, 2) };
    let off = ScanPair { kind: PAIR_LOOP, status: PAIR_SWITCHED_OFF, ..pair(0, 1) };
    (loops, [closed, rejected, off])
}

/// What is known beside it: the truth stands turned by a quarter and 100 m away; scan 1 truly is at (3, 4.2).
pub(crate) fn facts() -> RunFacts {
    let world_from_map = pose(100.0, 0.0, std::f64::consts::FRAC_PI_2);
    let truth =
        BTreeMap::from([(10, world_from_map), (11, world_from_map * pose(3.0, 4.2, 0.0)), (12, Pose::identity())]);
    let in_world = |x: f64, y: f64| {
        let p = world_from_map * nalgebra::Point3::new(x, y, 0.0);
        [p.x, p.y]
    };
    let service = |name: &str, lost_messages| ServiceTotals {
        name: name.into(),
        lost_messages,
        copied_payload_bytes: 8,
        resident_bytes: 12_000_000,
        ..ServiceTotals::default()
    };
    RunFacts {
        title: "Three <scans> & a plan".into(),
        truth: Some(truth),
        truth_cells: Some(vec![in_world(0.25, 0.25), in_world(0.75, 0.25), in_world(5.0, 5.0), in_world(-3.0, 1.0)]),
        scene: None,
        robot_from_scanner: None,
        registration: None,
        restarts: 2,
        services: vec![service("alignment", 1), service("planning", 2)],
        interrupted: false,
        fault: None,
        wall_time: Duration::from_millis(4500),
        config: "seed = 1\n".into(),
    }
}
