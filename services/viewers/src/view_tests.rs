use super::*;
use crate::{CHANNELS, DOTS, Stamps};
use foxglove::messages::{FrameTransform, Grid, Log, PointCloud, PosesInFrame, SceneUpdate};
use foxglove::{Decode, Encode};
use mirador_ipc_schema::messages::{
    ALIGNMENT_REJECTED, CandidateView, Envelope, LoopClosingMeta, MapCell, MapTile, PoseCorrection, RobotPose, ScanId,
    ScanMeta, ScoredScanMeta, Waypoint, Zone,
};

const IDENTITY: [f64; 16] = [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.];

/// Keeps what is drawn.
#[derive(Default)]
struct Kept {
    drawings: Vec<(&'static str, Stamps, Vec<u8>)>,
    unwanted: Vec<&'static str>,
}

impl Sink for Kept {
    type Error = String;

    fn wants(&self, channel: &'static str) -> bool {
        !self.unwanted.contains(&channel)
    }

    fn draw<M: Encode>(&mut self, channel: &'static str, stamps: Stamps, message: &M) -> Result<(), String> {
        let mut bytes = Vec::new();
        message.encode(&mut bytes).map_err(|e| e.to_string())?;
        self.drawings.push((channel, stamps, bytes));
        Ok(())
    }
}

impl Kept {
    fn all<M: Decode>(&self, channel: &str) -> Vec<M> {
        let on_channel = self.drawings.iter().filter(|(c, ..)| *c == channel);
        on_channel.map(|(.., bytes)| M::decode(bytes.as_slice()).ok().unwrap()).collect()
    }

    fn last<M: Decode>(&self, channel: &str) -> M {
        self.all(channel).pop().unwrap_or_else(|| panic!("nothing on {channel}"))
    }

    fn channels(&self) -> BTreeSet<&'static str> {
        self.drawings.iter().map(|(c, ..)| *c).collect()
    }
}

fn view(share: Option<f64>) -> View {
    View::new(ViewConfig { most_points: 100, share, clock_offset_ns: 0 })
}

fn header(scan: u32, sent_ns: u64) -> Header {
    let id = ScanId { robot: 1, run: 2, scan }.pack();
    Header { id, stamp_ns: i64::from(scan) * 1_000_000_000, sent_ns, ..Header::default() }
}

fn points(n: usize) -> Vec<Point> {
    (0..n).map(|i| Point { x: i as f32 * 0.01, y: -0.5, z: 0.25, intensity: 1, time: 0 }).collect()
}

fn aligned(scan: u32) -> AlignmentMeta {
    let mut map_from_scanner = IDENTITY;
    map_from_scanner[3] = 2.5;
    AlignmentMeta { header: header(scan, 10), map_from_scanner, status: 1, ..AlignmentMeta::default() }
}

/// Scan, pose and scores, without a plan.
fn scored_scan(view: &mut View, out: &mut Kept, scan: u32, n: usize) {
    let score = PointScore { quality: 65535, flags: 1, ..PointScore::default() };
    let mut scores = vec![score; n];
    scores[0].flags = 0;
    view.take::<topics::Scan, _>(out, &ScanMeta { header: header(scan, 1), ..ScanMeta::default() }, &points(n))
        .unwrap();
    view.take::<topics::Alignment, _>(out, &aligned(scan), &[]).unwrap();
    let meta = ScoredScanMeta { header: header(scan, 20), ..ScoredScanMeta::default() };
    view.take::<topics::ScoredScan, _>(out, &meta, &scores).unwrap();
}

fn plan(view: &mut View, out: &mut Kept, scan: u32) {
    let candidates = [
        CandidateView { position: [1.0, 2.0, 0.5], heading: 1.5, utility: 0.25, ..CandidateView::default() },
        CandidateView {
            position: [5.0, 6.0, 0.5],
            utility: 0.75,
            information: 0.5,
            cost: 7.0,
            ..CandidateView::default()
        },
        CandidateView { status: 3, reason: text::pack("too near"), ..CandidateView::default() },
    ];
    let meta =
        ViewPlanMeta { header: header(scan, 30), chosen: 1, reason: text::pack("the best"), ..ViewPlanMeta::default() };
    view.take::<topics::ViewPlan, _>(out, &meta, &candidates).unwrap();
}

#[test]
fn nothing_is_drawn_while_a_plan_is_worked_on() {
    let (mut view, mut out) = (view(None), Kept::default());
    scored_scan(&mut view, &mut out, 0, 9);
    assert!(out.drawings.is_empty());
    plan(&mut view, &mut out, 0);
    let drawn = [TF, POSES, CLOUD, MODEL, CANDIDATES, LOG, DOTS_CANDIDATES, DOTS_POSES];
    assert_eq!(out.channels(), BTreeSet::from(drawn));
}

#[test]
fn without_a_planner_a_scan_is_drawn_when_the_next_one_comes_or_nothing_more_does() {
    let (mut view, mut out) = (view(None), Kept::default());
    scored_scan(&mut view, &mut out, 0, 9);
    scored_scan(&mut view, &mut out, 1, 9);
    assert_eq!(out.all::<PointCloud>(CLOUD).len(), 1);
    view.settle(&mut out).unwrap();
    assert_eq!(out.all::<PointCloud>(CLOUD).len(), 2);
}

#[test]
fn a_cloud_is_thinned_and_carries_pose_colour_and_quality() {
    let (mut view, mut out) = (view(None), Kept::default());
    scored_scan(&mut view, &mut out, 0, 950);
    view.settle(&mut out).unwrap();
    let cloud: PointCloud = out.last(CLOUD);
    assert_eq!((cloud.frame_id.as_str(), cloud.point_stride, cloud.data.len()), ("map", 20, 95 * 20));
    assert_eq!(cloud.pose.unwrap().position.unwrap().x, 2.5);
    let numbers = |at: usize| f32::from_le_bytes(cloud.data[at..at + 4].try_into().unwrap());
    let tenth = points(11)[10];
    assert_eq!([20, 24, 28, 36].map(numbers), [tenth.x, tenth.y, tenth.z, 1.0]);
    assert_eq!(cloud.data[32..36], [250, 230, 60, 255]);
    assert!(numbers(16).is_nan() && cloud.data[12..16] == [130, 130, 130, 255], "not scored is grey");
    let names: Vec<_> = cloud.fields.iter().map(|f| (f.name.as_str(), f.offset)).collect();
    assert_eq!(
        names,
        [("x", 0), ("y", 4), ("z", 8), ("red", 12), ("green", 13), ("blue", 14), ("alpha", 15), ("quality", 16)]
    );
}

#[test]
fn a_scan_that_was_not_aligned_is_not_drawn_but_said() {
    let (mut view, mut out) = (view(None), Kept::default());
    let meta = ScanMeta { header: header(0, 1), ..ScanMeta::default() };
    view.take::<topics::Scan, _>(&mut out, &meta, &points(9)).unwrap();
    let rejected = AlignmentMeta { status: ALIGNMENT_REJECTED, reason: text::pack("nothing fits"), ..aligned(0) };
    view.take::<topics::Alignment, _>(&mut out, &rejected, &[]).unwrap();
    let meta = ScoredScanMeta { header: header(0, 20), ..ScoredScanMeta::default() };
    view.take::<topics::ScoredScan, _>(&mut out, &meta, &[PointScore::default(); 9]).unwrap();
    view.settle(&mut out).unwrap();
    assert_eq!(out.channels(), BTreeSet::from([LOG]));
    assert_eq!(out.last::<Log>(LOG).message, "scan 0 is not aligned: nothing fits");
}

#[test]
fn candidates_carry_their_terms_and_the_chosen_one_comes_first() {
    let (mut view, mut out) = (view(None), Kept::default());
    plan(&mut view, &mut out, 0);
    let scene: SceneUpdate = out.last(CANDIDATES);
    assert_eq!(scene.deletions.len(), 1, "the ones of the plan before go");
    let ids: Vec<_> = scene.entities.iter().map(|e| e.id.as_str()).collect();
    assert_eq!(ids, ["candidate 1", "candidate 0", "candidate 2"]);
    let of = |entity: usize, key: &str| {
        let metadata = &scene.entities[entity].metadata;
        metadata.iter().find(|pair| pair.key == key).unwrap_or_else(|| panic!("no {key}")).value.clone()
    };
    assert_eq!(
        (of(0, "state"), of(0, "u utility"), of(0, "A information")),
        ("chosen".into(), "0.7500".into(), "0.5000".into())
    );
    assert_eq!((of(0, "C cost"), of(1, "state")), ("7.0000".into(), "valued".into()));
    assert_eq!(of(2, "state"), "rejected: too near");
    assert_eq!(scene.entities[1].arrows[0].pose.as_ref().unwrap().position.unwrap().y, 2.0);
    assert_eq!(out.last::<Log>(LOG).message, "scan 0: candidate 1: the best");
    assert!(out.last::<PointCloud>(DOTS_CANDIDATES).data.len() > 3 * 16);
}

#[test]
fn zones_and_path_are_drawn_where_they_are() {
    let (mut view, mut out) = (view(None), Kept::default());
    let meta = Envelope { header: header(0, 5) };
    let zone = Zone { centre: [1.0, 2.0, 3.0], normal: [0.0, 4.0, 0.0], area: 4.0, scan: 7, ..Zone::default() };
    view.take::<topics::Zones, _>(&mut out, &meta, &[zone]).unwrap();
    let scene: SceneUpdate = out.last(ZONES);
    let arrow = &scene.entities[0].arrows[0];
    let turn = arrow.pose.as_ref().unwrap().orientation.unwrap();
    let half = 0.5_f64.sqrt();
    assert!((turn.z - half).abs() < 1e-9 && (turn.w - half).abs() < 1e-9, "x turned into y: {turn:?}");
    assert!((arrow.shaft_length + arrow.head_length - 2.0).abs() < 1e-9);
    assert_eq!(out.last::<PointCloud>(DOTS_ZONES).data.len(), 21 * 16);
    let way = [[0.0, 0.0, 0.0], [0.0, 2.0, 0.0]].map(|position| Waypoint { position, ..Waypoint::default() });
    let meta = mirador_ipc_schema::messages::PathMeta { header: header(0, 6), ..Default::default() };
    view.take::<topics::Path, _>(&mut out, &meta, &way).unwrap();
    let path: PosesInFrame = out.last(PATH);
    assert_eq!(path.poses[1].position.unwrap().y, 2.0);
    assert!((path.poses[0].orientation.unwrap().z - half).abs() < 1e-9, "it looks along y");
}

#[test]
fn a_correction_moves_trajectory_cloud_and_model() {
    let (mut view, mut out) = (view(None), Kept::default());
    scored_scan(&mut view, &mut out, 0, 9);
    view.settle(&mut out).unwrap();
    let mut moved = IDENTITY;
    moved[3] = 4.0;
    let correction = PoseCorrection { id: header(0, 0).id, map_from_scanner: moved, ..PoseCorrection::default() };
    view.take::<topics::PoseCorrections, _>(&mut out, &Envelope { header: header(1, 25) }, &[correction]).unwrap();
    let x: Vec<f64> = out.all::<PosesInFrame>(POSES).iter().map(|p| p.poses[0].position.unwrap().x).collect();
    assert_eq!(x, [2.5, 4.0]);
    assert_eq!(out.last::<PointCloud>(CLOUD).pose.unwrap().position.unwrap().x, 4.0);
    assert_eq!(out.last::<FrameTransform>(TF).translation.unwrap().x, 4.0);
    let model: PointCloud = out.last(MODEL);
    let x = f32::from_le_bytes(model.data[..4].try_into().unwrap());
    assert!((x - 4.01).abs() < 1e-5, "the first point that was scored: {x}");
}

#[test]
fn the_grid_covers_all_tiles_and_leaves_unknown_cells_transparent() {
    let (mut view, mut out) = (view(None), Kept::default());
    let mut tile = MapTile { tile_x: -1, tile_y: 2, ..MapTile::default() };
    tile.cells[17] = MapCell { navigability: 65535, flags: 1, height: 0.75, ..MapCell::default() };
    let other = MapTile { tile_x: 0, tile_y: 2, ..MapTile::default() };
    let meta = MapMeta { header: header(0, 3), cell_m: 0.5, parts: 2, ..MapMeta::default() };
    view.take::<topics::InformationMap, _>(&mut out, &meta, &[tile]).unwrap();
    assert!(out.drawings.is_empty(), "half an update is not drawn");
    view.take::<topics::InformationMap, _>(&mut out, &MapMeta { part: 1, ..meta }, &[other]).unwrap();
    let grid: Grid = out.last(GRID);
    assert_eq!((grid.column_count, grid.data.len()), (32, 32 * 16 * 4));
    let corner = grid.pose.unwrap().position.unwrap();
    assert_eq!((corner.x, corner.y), (-8.0, 16.0));
    let at = (32 + 1) * 4;
    assert_eq!(&grid.data[at..at + 4], [40, 150, 65, 255]);
    assert_eq!(grid.data.iter().filter(|b| **b != 0).count(), 4);
    let dots: PointCloud = out.last(DOTS_MAP);
    let numbers: Vec<f32> = dots.data[..12].chunks(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    assert_eq!((dots.data.len(), numbers), (16, vec![-7.25, 16.75, 0.75]));
}

#[test]
fn the_robot_is_drawn_when_it_has_moved() {
    let (mut view, mut out) = (view(None), Kept::default());
    for x in [0.0, 0.01, 0.04, 0.07, 0.5] {
        let mut map_from_robot = IDENTITY;
        map_from_robot[3] = x;
        let pose = RobotPose { map_from_robot, ..RobotPose::default() };
        view.take::<topics::RobotPoses, _>(&mut out, &Envelope { header: header(0, 1) }, &[pose]).unwrap();
    }
    let frames: Vec<FrameTransform> = out.all(TF);
    assert!(frames.iter().all(|f| f.child_frame_id == "robot"));
    assert_eq!(frames.iter().map(|f| f.translation.unwrap().x).collect::<Vec<_>>(), [0.0, 0.07, 0.5]);
}

#[test]
fn what_grows_is_drawn_within_its_share_and_at_the_end() {
    let (mut limited, mut free) = (view(Some(0.02)), view(None));
    let (mut seldom, mut often) = (Kept::default(), Kept::default());
    // One long row of tiles: the grid is 4 bytes a cell, the message about it only as large as one tile.
    for n in 0..60 {
        for (view, out) in [(&mut limited, &mut seldom), (&mut free, &mut often)] {
            let tile = MapTile { tile_x: n, ..MapTile::default() };
            let meta = MapMeta { header: header(n as u32, 3), cell_m: 0.5, parts: 1, ..MapMeta::default() };
            view.take::<topics::InformationMap, _>(out, &meta, &[tile]).unwrap();
        }
    }
    assert_eq!(often.all::<Grid>(GRID).len(), 60);
    let drawn = seldom.all::<Grid>(GRID).len();
    assert!((2..20).contains(&drawn), "{drawn}");
    limited.finish(&mut seldom).unwrap();
    assert_eq!(seldom.last::<Grid>(GRID).column_count, 60 * 16);
}

#[test]
fn who_comes_late_gets_everything_there_is() {
    let (mut view, mut out) = (view(None), Kept::default());
    out.unwanted = CHANNELS.iter().map(|c| c.topic).collect();
    scored_scan(&mut view, &mut out, 0, 9);
    plan(&mut view, &mut out, 0);
    assert!(out.drawings.is_empty(), "nobody wants it");
    let mut late = Kept::default();
    for channel in CHANNELS {
        view.present(&mut late, channel.topic).unwrap();
    }
    view.present(&mut late, "/smell").unwrap();
    let there = [TF, POSES, CLOUD, MODEL, CANDIDATES, LOG, DOTS_CANDIDATES, DOTS_POSES];
    assert_eq!(late.channels(), BTreeSet::from(there));
    assert_eq!(late.all::<Log>(LOG).len(), 1);
}

#[test]
fn the_view_goes_on_where_an_earlier_incarnation_left_it() {
    let (mut view, mut out) = (view(None), Kept::default());
    view.restore("alignment", bytemuck::bytes_of(&aligned(0)));
    view.restore("alignment", &[1, 2, 3]);
    view.restore("loop_closing", bytemuck::bytes_of(&LoopClosingMeta::default()));
    view.settle(&mut out).unwrap();
    assert!(out.drawings.is_empty(), "it was drawn then");
    view.take::<topics::Alignment, _>(&mut out, &aligned(1), &[]).unwrap();
    assert_eq!(out.last::<PosesInFrame>(POSES).poses.len(), 2);
}

#[test]
fn the_time_of_a_drawing_is_when_its_message_was_sent() {
    let (mut view, mut out) = (view(None), Kept::default());
    scored_scan(&mut view, &mut out, 3, 9);
    view.settle(&mut out).unwrap();
    let (_, stamps, _) = out.drawings.iter().find(|(c, ..)| *c == CLOUD).unwrap();
    assert_eq!(*stamps, Stamps { sequence: 3, log_time: 20, publish_time: 3_000_000_000 });
    assert_eq!(out.last::<PointCloud>(CLOUD).timestamp.unwrap().nsec(), 20);
}

#[test]
fn every_channel_has_a_schema_and_a_name_of_its_own() {
    let names: BTreeSet<_> = CHANNELS.iter().map(|c| c.topic).collect();
    assert_eq!(names.len(), CHANNELS.len());
    assert!(DOTS.iter().all(|dots| names.contains(dots)));
    for channel in CHANNELS {
        let (schema, encoding) = (channel.declaration)();
        assert!(schema.name.starts_with("foxglove.") && !schema.data.is_empty(), "{}", channel.topic);
        assert_eq!(encoding, "protobuf");
    }
}

#[test]
fn the_topics_that_are_drawn_exist() {
    for topic in TOPICS {
        assert!(topics::ALL.iter().any(|known| known.rules.name == topic), "{topic}");
    }
}

#[test]
fn live_drawings_are_dated_beside_the_time_of_day() {
    let mut view = View::new(ViewConfig { most_points: 100, share: None, clock_offset_ns: 5_000 });
    let mut out = Kept::default();
    view.take::<topics::Alignment, _>(&mut out, &aligned(0), &[]).unwrap();
    assert_eq!(out.drawings[0].1.log_time, 5_010);
}
