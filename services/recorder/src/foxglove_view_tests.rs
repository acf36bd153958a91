use super::*;
use crate::RecorderConfig;
use crate::testing::{IDENTITY, header, points};
use foxglove::Decode;
use mirador_ipc_schema::messages::MapCell;

/// The messages of a view channel after `draw`.
fn drawn(channel: &str, draw: impl FnOnce(&mut FoxgloveView, &mut RunWriter)) -> Vec<Vec<u8>> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let mut writer = RunWriter::create(&path, &RecorderConfig::default()).unwrap();
    draw(&mut FoxgloveView::new(100), &mut writer);
    writer.finish().unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let messages = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap);
    messages.filter(|m| m.channel.topic == channel).map(|m| m.data.into_owned()).collect()
}

fn aligned(scan: u32) -> AlignmentMeta {
    let mut map_from_scanner = IDENTITY;
    map_from_scanner[3] = 2.5;
    AlignmentMeta { header: header(scan, 10), map_from_scanner, status: 1, ..AlignmentMeta::default() }
}

#[test]
fn a_cloud_is_thinned_and_carries_pose_and_quality() {
    let scores = [PointScore { quality: 65535, ..PointScore::default() }; 950];
    let clouds = drawn(CLOUD, |view, out| {
        view.scan(&header(0, 1), &points(0, 950));
        view.scored(out, &header(0, 2), &scores).unwrap();
        view.alignment(out, &aligned(0)).unwrap();
    });
    assert_eq!(clouds.len(), 1);
    let cloud = PointCloud::decode(clouds[0].as_slice()).unwrap();
    assert_eq!((cloud.frame_id.as_str(), cloud.point_stride), ("map", 16));
    assert_eq!(cloud.pose.unwrap().position.unwrap().x, 2.5);
    assert_eq!(cloud.data.len(), 95 * 16);
    let second: Vec<f32> = cloud.data[16..32].chunks(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    let tenth = points(0, 11)[10];
    assert_eq!(second, [tenth.x, tenth.y, tenth.z, 1.0]);
}

#[test]
fn a_scan_that_was_not_aligned_is_not_drawn() {
    let clouds = drawn(CLOUD, |view, out| {
        view.scan(&header(0, 1), &points(0, 9));
        view.alignment(out, &AlignmentMeta { status: ALIGNMENT_REJECTED, ..aligned(0) }).unwrap();
        view.scored(out, &header(0, 2), &[PointScore::default(); 9]).unwrap();
    });
    assert!(clouds.is_empty());
}

#[test]
fn a_correction_moves_the_trajectory() {
    let poses = drawn(POSES, |view, out| {
        view.alignment(out, &aligned(0)).unwrap();
        let mut moved = IDENTITY;
        moved[3] = 4.0;
        let correction = PoseCorrection { id: header(0, 0).id, map_from_scanner: moved, ..PoseCorrection::default() };
        view.corrections(out, &header(1, 5), &[correction]).unwrap();
    });
    let x = |bytes: &Vec<u8>| PosesInFrame::decode(bytes.as_slice()).unwrap().poses[0].position.unwrap().x;
    assert_eq!(poses.iter().map(x).collect::<Vec<_>>(), [2.5, 4.0]);
}

#[test]
fn trajectory_and_map_go_on_where_an_earlier_incarnation_left_them() {
    let poses = drawn(POSES, |view, out| {
        view.restore("alignment", bytemuck::bytes_of(&aligned(0)));
        view.restore("alignment", &[1, 2, 3]);
        view.alignment(out, &aligned(1)).unwrap();
    });
    assert_eq!(PosesInFrame::decode(poses[0].as_slice()).unwrap().poses.len(), 2);
}

#[test]
fn the_grid_covers_all_tiles_and_leaves_unknown_cells_transparent() {
    let grids = drawn(GRID, |view, out| {
        let mut tile = MapTile { tile_x: -1, tile_y: 2, ..MapTile::default() };
        tile.cells[17] = MapCell { navigability: 65535, flags: 1, ..MapCell::default() };
        let other = MapTile { tile_x: 0, tile_y: 2, ..MapTile::default() };
        let meta = MapMeta { header: header(0, 3), cell_m: 0.5, parts: 1, ..MapMeta::default() };
        view.map(out, &meta, &[tile, other]).unwrap();
    });
    let grid = Grid::decode(grids[0].as_slice()).unwrap();
    assert_eq!((grid.column_count, grid.data.len()), (32, 32 * 16 * 4));
    let corner = grid.pose.unwrap().position.unwrap();
    assert_eq!((corner.x, corner.y), (-8.0, 16.0));
    let at = (32 + 1) * 4;
    assert_eq!(&grid.data[at..at + 4], [0, 255, 40, 255]);
    assert_eq!(grid.data.iter().filter(|b| **b != 0).count(), 3);
}
