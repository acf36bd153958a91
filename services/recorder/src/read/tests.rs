use super::*;
use crate::MESSAGE_ENCODING;
use crate::testing::{points, record_run};
use crate::{Compression, RecorderConfig};
use proptest::prelude::*;
use std::collections::BTreeMap as Map;

fn run_bytes(compression: Compression) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let config = RecorderConfig { compression, chunk_bytes: 1 << 10, foxglove: false, ..RecorderConfig::default() };
    record_run(&path, &config, 4, 50);
    std::fs::read(&path).unwrap()
}

/// Opens `bytes` as a file and reads everything in it; returns the scans that came out.
fn read_all(bytes: &[u8]) -> Result<Vec<u32>, ReadError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    std::fs::write(&path, bytes).unwrap();
    let mut reader = RunReader::open(&path)?;
    let mut scans = Vec::new();
    reader.for_each::<topics::Scan>(|meta, _| scans.push(meta.header.scan()))?;
    reader.for_each::<topics::Alignment>(|_, _| {})?;
    reader.for_each::<topics::ScoredScan>(|_, _| {})?;
    reader.for_each::<topics::ViewPlan>(|_, _| {})?;
    reader.for_each_meta::<topics::Scan>(|_, _| {})?;
    Ok(scans)
}

#[test]
fn everything_comes_back_bit_for_bit() {
    for compression in [Compression::None, Compression::Lz4] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        record_run(&path, &RecorderConfig { compression, ..RecorderConfig::default() }, 3, 1000);
        let mut reader = RunReader::open(&path).unwrap();
        assert!(reader.is_complete());
        assert_eq!(reader.scan_index(), [0, 1, 2]);
        let mut seen = 0;
        reader
            .for_each::<topics::Scan>(|meta, items| {
                assert_eq!(items, points(seen, 1000));
                assert_eq!(meta.header.scan(), seen);
                seen += 1;
            })
            .unwrap();
        assert_eq!(seen, 3);
        let mut lengths = Vec::new();
        reader.for_each_meta::<topics::ScoredScan>(|meta, n| lengths.push((meta.header.scan(), n))).unwrap();
        assert_eq!(lengths, [(0, 1000), (1, 1000), (2, 1000)]);
    }
}

#[test]
fn a_scan_is_read_by_its_number() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    record_run(&path, &RecorderConfig::default(), 3, 100);
    let mut reader = RunReader::open(&path).unwrap();
    for scan in [2, 0, 1] {
        let mut called = false;
        reader
            .read_scan(scan, &mut |meta, items| {
                called = meta.header.scan() == scan && items == points(scan, 100);
            })
            .unwrap();
        assert!(called);
    }
    let error = reader.read_scan(7, &mut |_, _| {}).unwrap_err().to_string();
    assert!(error.contains("no scan 7") && error.contains("3 scans from 0 to 2"), "{error}");
}

#[test]
fn a_file_cut_off_anywhere_gives_its_complete_chunks() {
    for compression in [Compression::None, Compression::Lz4] {
        let bytes = run_bytes(compression);
        let mut last = 0;
        for end in (0..bytes.len()).step_by(97) {
            match read_all(&bytes[..end]) {
                Ok(scans) => {
                    assert_eq!(scans, (0..scans.len() as u32).collect::<Vec<_>>());
                    assert!(scans.len() >= last, "a longer file gives more scans");
                    last = scans.len();
                }
                Err(ReadError::NotMcap { .. } | ReadError::Empty { .. }) => assert_eq!(last, 0),
                Err(error) => panic!("cut at {end}: {error}"),
            }
        }
        assert_eq!(last, 4);
    }
}

#[test]
fn a_changed_point_is_noticed_by_the_checksum() {
    let mut bytes = run_bytes(Compression::None);
    let point = points(2, 50)[30];
    let needle = bytemuck::bytes_of(&point);
    let at = bytes.windows(16).position(|w| w == needle).unwrap();
    bytes[at] ^= 1;
    assert!(matches!(read_all(&bytes), Err(ReadError::Damaged { .. })));
}

#[test]
fn a_recording_of_another_program_is_refused() {
    let mut bytes = Vec::new();
    let mut writer =
        mcap::WriteOptions::new().profile("ros2").compression(None).create(std::io::Cursor::new(&mut bytes)).unwrap();
    let schema = writer.add_schema("sensor_msgs/msg/PointCloud2", "ros2msg", b"uint8[] data").unwrap();
    let channel = writer.add_channel(schema, "/velodyne_points", "cdr", &Map::new()).unwrap();
    let head = mcap::records::MessageHeader { channel_id: channel, sequence: 0, log_time: 0, publish_time: 0 };
    writer.write_to_known_channel(&head, &[1, 2, 3]).unwrap();
    writer.finish().unwrap();
    drop(writer);
    let error = read_all(&bytes).unwrap_err();
    assert!(matches!(error, ReadError::NotOurs { .. }));
    let text = error.to_string();
    assert!(text.contains("ros2") && text.contains("/velodyne_points"), "{text}");
}

#[test]
fn another_layout_is_refused_with_both_versions() {
    let mut bytes = Vec::new();
    let mut writer = mcap::WriteOptions::new().compression(None).create(std::io::Cursor::new(&mut bytes)).unwrap();
    let old = topics::describe::<topics::Scan>().replace("\"range_min_m\"", "\"range_min\"");
    let schema = writer.add_schema("mirador/scan", crate::SCHEMA_ENCODING, old.as_bytes()).unwrap();
    writer.add_channel(schema, "mirador/scan", MESSAGE_ENCODING, &Map::new()).unwrap();
    writer.finish().unwrap();
    drop(writer);
    match read_all(&bytes) {
        Err(ReadError::Layout { topic, recorded, current, .. }) => {
            assert_eq!((topic.as_str(), recorded), ("scan", old));
            assert_eq!(current, topics::describe::<topics::Scan>());
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_file_that_is_no_recording_is_refused() {
    assert!(matches!(read_all(b""), Err(ReadError::NotMcap { .. })));
    assert!(matches!(read_all(b"PK not an mcap file"), Err(ReadError::NotMcap { .. })));
    assert!(matches!(read_all(mcap::MAGIC), Err(ReadError::Empty { .. })));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    #[test]
    fn mutated_bytes_never_panic(
        lz4: bool,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        end in any::<prop::sample::Index>(),
        cut: bool,
    ) {
        static RUNS: std::sync::OnceLock<[Vec<u8>; 2]> = std::sync::OnceLock::new();
        let runs = RUNS.get_or_init(|| [run_bytes(Compression::None), run_bytes(Compression::Lz4)]);
        let mut bytes = runs[usize::from(lz4)].clone();
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if cut {
            bytes.truncate(end.index(bytes.len()));
        }
        // Any outcome but a panic is right; what does come out must be scans that were written.
        if let Ok(scans) = read_all(&bytes) {
            prop_assert!(scans.len() <= 4);
        }
    }
}
