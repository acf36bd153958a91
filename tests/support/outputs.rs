//! What the files of an output folder say, read the way a user's own tool would.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use mirador_core::geometry::{Pose, pose_from_rows};
use mirador_ipc_schema::messages::{
    AlignmentMeta, CandidateView, Header, Hypothesis, LoopClosingMeta, MapMeta, MapTile, PathMeta, PointScore,
    ScanMeta, ScanPair, ScoredScanMeta, ViewPlanMeta, Waypoint,
};
use mirador_ipc_schema::{ScanId, topics};
use mirador_recorder::{RUN_FILE, RunReader};
use serde_json::Value;

/// Bytes of one point of `model.ply`: x, y, z, quality as f32, scan as u32, intensity as u16, aligned as u8.
const MODEL_ROW: usize = 23;

/// One point of `model.ply` beside its coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModelPoint {
    pub quality: f32,
    pub scan: u32,
    pub aligned: u8,
}

/// `model.ply` as its bytes say it.
pub struct Model {
    pub comments: Vec<String>,
    pub points: Vec<ModelPoint>,
}

impl Model {
    /// Reads a model with coordinates in f32, and checks that the header's count is that of the file.
    pub fn read(out: &Path) -> Self {
        let bytes = fs::read(out.join("model.ply")).unwrap();
        let mark = b"end_header\n";
        let end = bytes.windows(mark.len()).position(|w| w == mark).expect("a header") + mark.len();
        let header = std::str::from_utf8(&bytes[..end]).unwrap();
        let lines = |prefix: &str| -> Vec<String> {
            header.lines().filter_map(|l| l.strip_prefix(prefix)).map(str::to_owned).collect()
        };
        let expected =
            ["float x", "float y", "float z", "float quality", "uint scan", "ushort intensity", "uchar aligned"];
        assert_eq!(lines("property "), expected);
        let count: usize = lines("element vertex ")[0].parse().unwrap();
        assert_eq!(bytes.len() - end, count * MODEL_ROW, "the count of the header is that of the file");
        let points = bytes[end..].chunks_exact(MODEL_ROW).map(|row| ModelPoint {
            quality: f32::from_le_bytes(row[12..16].try_into().unwrap()),
            scan: u32::from_le_bytes(row[16..20].try_into().unwrap()),
            aligned: row[22],
        });
        Self { comments: lines("comment "), points: points.collect() }
    }
}

/// The poses of `summary.json`, map_from_scanner.
pub fn poses(summary: &Value) -> Vec<Pose> {
    let rows = summary["poses"].as_array().unwrap().iter().map(|p| &p["map_from_scanner"]);
    rows.map(|rows| {
        let values: Vec<f64> = rows.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
        pose_from_rows(&values.try_into().unwrap()).unwrap()
    })
    .collect()
}

/// Opens the recording of a run.
pub fn recording(out: &Path) -> RunReader {
    RunReader::open(&out.join(RUN_FILE)).unwrap()
}

/// Bytes of everything that was decided about one scan, without wall times and without the number of the run.
#[derive(Debug, PartialEq, Eq)]
pub struct Decisions {
    pub scan: Vec<u8>,
    pub alignment: Vec<u8>,
    pub hypotheses: Vec<u8>,
    pub loops: Vec<u8>,
    pub scored: Vec<u8>,
    pub scores: Vec<u8>,
    pub plan: Vec<u8>,
    pub candidates: Vec<u8>,
    pub path: Vec<u8>,
    pub map: Vec<u8>,
}

/// The decisions of a run by scan.
pub fn decisions(out: &Path) -> BTreeMap<u32, Decisions> {
    let mut reader = recording(out);
    let mut all = BTreeMap::new();
    for scan in reader.scan_index() {
        all.insert(scan, decisions_about(&mut reader, scan));
    }
    all
}

fn decisions_about(reader: &mut RunReader, number: u32) -> Decisions {
    let (mut points, mut hypotheses): (Vec<_>, Vec<Hypothesis>) = (Vec::new(), Vec::new());
    let (mut scores, mut candidates): (Vec<PointScore>, Vec<CandidateView>) = (Vec::new(), Vec::new());
    let mut pairs: Vec<ScanPair> = Vec::new();
    let (mut waypoints, mut tiles): (Vec<Waypoint>, Vec<MapTile>) = (Vec::new(), Vec::new());
    let scan = reader.read_about::<topics::Scan>(number, &mut points).unwrap().expect("the scan");
    let alignment = reader.read_about::<topics::Alignment>(number, &mut hypotheses).unwrap().expect("its alignment");
    let loops =
        reader.read_about::<topics::LoopClosing>(number, &mut pairs).unwrap().expect("what came of older scans");
    let scored = reader.read_about::<topics::ScoredScan>(number, &mut scores).unwrap().expect("its scores");
    let plan = reader.read_about::<topics::ViewPlan>(number, &mut candidates).unwrap().expect("its plan");
    let path = reader.read_about::<topics::Path>(number, &mut waypoints).unwrap().expect("its path");
    let map = reader.read_about::<topics::InformationMap>(number, &mut tiles).unwrap().unwrap_or_default();
    let scan = ScanMeta { header: timeless(&scan.header), ..scan };
    let alignment = AlignmentMeta { header: timeless(&alignment.header), prepare_ns: 0, align_ns: 0, ..alignment };
    let loops = LoopClosingMeta { header: timeless(&loops.header), correction_ns: 0, ..loops };
    for pair in &mut pairs {
        // The ids hold the number of the run.
        for id in [&mut pair.target_id, &mut pair.source_id] {
            *id = ScanId::unpack(*id).scan.into();
        }
    }
    let scored = ScoredScanMeta {
        header: timeless(&scored.header),
        scan_sent_ns: 0,
        alignment_sent_ns: 0,
        surface_ns: 0,
        analysis_ns: 0,
        ..scored
    };
    let plan = ViewPlanMeta { header: timeless(&plan.header), scan_sent_ns: 0, map_ns: 0, planning_ns: 0, ..plan };
    let path = PathMeta { header: timeless(&path.header), ..path };
    let map = MapMeta { header: timeless(&map.header), ..map };
    Decisions {
        scan: [bytemuck::bytes_of(&scan), bytemuck::cast_slice(&points)].concat(),
        alignment: bytemuck::bytes_of(&alignment).to_vec(),
        hypotheses: bytemuck::cast_slice(&hypotheses).to_vec(),
        loops: [bytemuck::bytes_of(&loops), bytemuck::cast_slice(&pairs)].concat(),
        scored: bytemuck::bytes_of(&scored).to_vec(),
        scores: bytemuck::cast_slice(&scores).to_vec(),
        plan: bytemuck::bytes_of(&plan).to_vec(),
        candidates: bytemuck::cast_slice(&candidates).to_vec(),
        path: [bytemuck::bytes_of(&path), bytemuck::cast_slice(&waypoints)].concat(),
        map: [bytemuck::bytes_of(&map), bytemuck::cast_slice(&tiles)].concat(),
    }
}

/// The part of a header that belongs to the data: which scan, and when it was taken.
fn timeless(header: &Header) -> Header {
    Header { id: u64::from(header.scan()), stamp_ns: header.stamp_ns, clock_id: header.clock_id, ..Header::default() }
}

/// Panics unless two runs gave the same bits: files and decisions.
pub fn assert_same_bits(a: &Path, b: &Path) {
    for file in ["trajectory.tum", "model.ply", "map.png"] {
        assert!(fs::read(a.join(file)).unwrap() == fs::read(b.join(file)).unwrap(), "{file} differs");
    }
    let (of_a, of_b) = (decisions(a), decisions(b));
    assert_eq!(of_a.keys().collect::<Vec<_>>(), of_b.keys().collect::<Vec<_>>(), "the scans");
    assert!(!of_a.is_empty());
    for (scan, a) in &of_a {
        let b = &of_b[scan];
        let parts = [
            ("scan", &a.scan, &b.scan),
            ("alignment", &a.alignment, &b.alignment),
            ("hypotheses", &a.hypotheses, &b.hypotheses),
            ("loop_closing", &a.loops, &b.loops),
            ("scored_scan", &a.scored, &b.scored),
            ("scores", &a.scores, &b.scores),
            ("view_plan", &a.plan, &b.plan),
            ("candidates", &a.candidates, &b.candidates),
            ("path", &a.path, &b.path),
            ("information_map", &a.map, &b.map),
        ];
        for (part, a, b) in parts {
            let place = a.iter().zip(b).position(|(a, b)| a != b);
            assert!(a == b, "{part} of scan {scan} differs: {} and {} bytes, first at {place:?}", a.len(), b.len());
        }
    }
}
