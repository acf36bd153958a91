//! Captures written here from the manuals' description of the packets.

use std::path::{Path, PathBuf};

use etherparse::PacketBuilder;
use proptest::prelude::*;

use super::*;
use crate::scan::{Grid, Point};

const VLP16: u8 = 0x22;
const HDL32E: u8 = 0x21;

/// A data packet whose head is at `azimuth(firing)` [1/100 deg], all ranges `range_m(azimuth [rad], laser)`.
fn packet(model: u8, azimuths: &[u32; 12], range_m: impl Fn(u32, usize) -> f64) -> Vec<u8> {
    let mut bytes = Vec::new();
    for azimuth in azimuths {
        bytes.extend([0xff, 0xee]);
        bytes.extend((*azimuth as u16).to_le_bytes());
        for channel in 0..32 {
            bytes.extend(((range_m(*azimuth, channel) / 0.002).round() as u16).to_le_bytes());
            bytes.push(channel as u8);
        }
    }
    bytes.extend(123_456_u32.to_le_bytes());
    bytes.extend([0x37, model]);
    bytes
}

fn ethernet(payload: &[u8]) -> Vec<u8> {
    let builder = PacketBuilder::ethernet2([1; 6], [2; 6]).ipv4([192, 168, 1, 201], [255; 4], 64).udp(443, 2368);
    let mut out = Vec::new();
    builder.write(&mut out, payload).unwrap();
    out
}

/// A classic capture: header, then packets with their times [us].
fn pcap(packets: &[(i64, Vec<u8>)]) -> Vec<u8> {
    let mut out = Vec::new();
    out.extend(0xa1b2_c3d4_u32.to_le_bytes());
    out.extend([2, 0, 4, 0]);
    out.extend([0; 8]);
    out.extend(65535_u32.to_le_bytes());
    out.extend(1_u32.to_le_bytes());
    for (us, data) in packets {
        out.extend(((us / 1_000_000) as u32).to_le_bytes());
        out.extend(((us % 1_000_000) as u32).to_le_bytes());
        out.extend((data.len() as u32).to_le_bytes());
        out.extend((data.len() as u32).to_le_bytes());
        out.extend(data);
    }
    out
}

/// The same as pcapng.
fn pcapng(packets: &[(i64, Vec<u8>)]) -> Vec<u8> {
    let block = |kind: u32, body: &[u8]| {
        let length = (body.len() + 12) as u32;
        [&kind.to_le_bytes()[..], &length.to_le_bytes(), body, &length.to_le_bytes()].concat()
    };
    let section = [&0x1a2b_3c4d_u32.to_le_bytes()[..], &[1, 0, 0, 0], &[0xff; 8]].concat();
    let interface = [&[1, 0, 0, 0][..], &65535_u32.to_le_bytes()].concat();
    let mut out = [block(0x0a0d_0d0a, &section), block(1, &interface)].concat();
    for (us, data) in packets {
        let mut body = 0_u32.to_le_bytes().to_vec();
        body.extend(((*us as u64 >> 32) as u32).to_le_bytes());
        body.extend((*us as u32).to_le_bytes());
        body.extend((data.len() as u32).to_le_bytes());
        body.extend((data.len() as u32).to_le_bytes());
        body.extend(data);
        body.resize(body.len().next_multiple_of(4), 0);
        out.extend(block(6, &body));
    }
    out
}

/// Packets of a VLP-16 that turns at 10 Hz from 90 deg on, in a round room of 5 m radius that is 8 m wide to the right.
fn turning(packets: usize) -> Vec<(i64, Vec<u8>)> {
    (0..packets)
        .map(|k| {
            let azimuths = std::array::from_fn(|block| (9_000 + 40 * (k * 12 + block) as u32) % 36_000);
            // Right of the sensor is 90 deg clockwise.
            let room = |azimuth: u32, _| if (8_000..10_000).contains(&azimuth) { 8.0 } else { 5.0 };
            (1_000_000 + 1_327 * k as i64, ethernet(&packet(VLP16, &azimuths, room)))
        })
        .collect()
}

fn write(bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.pcap");
    std::fs::write(&path, bytes).unwrap();
    (folder, path)
}

fn points(capture: &Capture, index: usize) -> Vec<Point> {
    let revolution = capture.revolutions()[index];
    let mut out = vec![Point::EMPTY; revolution.grid.cells()];
    capture.read(&revolution, &mut out).unwrap();
    out
}

#[test]
fn whole_revolutions_are_scans_and_cut_ones_are_none() {
    for bytes in [pcap(&turning(300)), pcapng(&turning(300))] {
        let (_folder, path) = write(&bytes);
        let capture = Capture::open(&path).unwrap();
        // 300 packets of 12 blocks of 0.4 deg are four turns, of which the first begins and the last ends somewhere.
        assert_eq!(capture.revolutions().len(), 3);
        for (k, revolution) in capture.revolutions().iter().enumerate() {
            assert_eq!(revolution.grid, Grid { rows: 1800, cols: 16 });
            // A turn is 75 packets; the seam is straight behind, a quarter turn after the first packet.
            let begins = 1_000_000_000 + 1_327_000 * (18 + 75 * k as i64);
            assert!((revolution.stamp_ns - begins).abs() <= 1_327_000, "{revolution:?}");
            assert!((revolution.duration_ns as f64 * 1e-9 - 0.0995).abs() < 0.002, "{revolution:?}");
            let points = points(&capture, k);
            let first = points[..16].iter().filter(|p| p.is_return()).count();
            assert_eq!(first, 16);
            let behind = points[0];
            assert!(behind.x < -4.0 && behind.y.abs() < 0.1, "the seam is behind: {behind:?}");
            assert!(points.iter().map(|p| p.time).is_sorted_by(|a, b| b.saturating_add(200) > *a), "time goes on");
            assert!(points[0].time < 700 && points.last().unwrap().time > 64_000);
        }
        assert_eq!(points(&capture, 1), points(&capture, 1), "read twice");
    }
}

#[test]
fn points_lie_where_the_manual_says() {
    let (_folder, path) = write(&pcap(&turning(200)));
    let points = points(&Capture::open(&path).unwrap(), 0);
    // Columns go from the lowest laser up: -15, -13, ..., 15 deg.
    for line in points.chunks(16) {
        for (column, point) in line.iter().enumerate() {
            let elevation = (point.z / point.range()).asin().to_degrees();
            assert!((elevation - (-15.0 + 2.0 * column as f32)).abs() < 0.01, "{column}: {elevation}");
        }
    }
    // The wide part of the room is on the right, where y is negative.
    let wide: Vec<_> = points.iter().filter(|p| p.range() > 7.0).collect();
    assert!(wide.len() > 1000 && wide.iter().all(|p| p.y < -6.0), "{}", wide.len());
    assert!(points.iter().all(|p| (p.range() - 5.0).abs() < 0.001 || (p.range() - 8.0).abs() < 0.001));
    // The strength is the channel's number, which is the order of firing: the lowest laser fires first.
    assert!(points.chunks(16).step_by(2).all(|line| line[0].intensity == 0 && line[8].intensity == 1));
}

#[test]
fn the_two_halves_of_a_vlp16_block_are_half_a_step_apart() {
    let (_folder, path) = write(&pcap(&turning(200)));
    let points = points(&Capture::open(&path).unwrap(), 0);
    let azimuth = |p: &Point| f64::from(-p.y).atan2(f64::from(p.x)).to_degrees().rem_euclid(360.0);
    // The lowest laser fires first, without any turn since the azimuth that is told.
    let steps: Vec<f64> = points
        .chunks(16)
        .zip(points.chunks(16).skip(1))
        .map(|(a, b)| (azimuth(&b[0]) - azimuth(&a[0])).rem_euclid(360.0))
        .collect();
    assert!(steps.iter().all(|step| (step - 0.2).abs() < 0.01), "{:?}", &steps[..5]);
}

#[test]
fn an_hdl32e_has_32_lasers_and_one_firing_a_block() {
    let packets: Vec<_> = (0..400)
        .map(|k| {
            let azimuths = std::array::from_fn(|block| (16 * (k * 12 + block) as u32) % 36_000);
            (553 * k as i64, ethernet(&packet(HDL32E, &azimuths, |_, channel| if channel == 3 { 0.0 } else { 10.0 })))
        })
        .collect();
    let (_folder, path) = write(&pcap(&packets));
    let capture = Capture::open(&path).unwrap();
    assert_eq!(capture.revolutions()[0].grid, Grid { rows: 2250, cols: 32 });
    let points = points(&capture, 0);
    let elevation = |p: &Point| (p.z / p.range()).asin().to_degrees();
    assert!((elevation(&points[0]) + 30.67).abs() < 0.01 && (elevation(&points[31]) - 10.67).abs() < 0.02);
    // Channel 3 is the second of the upper half; it has no return.
    assert!(points.chunks(32).all(|line| !line[17].is_return() && line[16].is_return()));
}

#[test]
fn other_traffic_and_damaged_packets_are_passed_over_and_counted() {
    let mut packets = turning(200);
    packets[50].1 = ethernet(b"hello");
    packets[60].1 = vec![0; 40];
    let mut damaged = packet(VLP16, &[100; 12], |_, _| 1.0);
    damaged[300] = 0;
    packets.insert(30, (1_000_000, ethernet(&damaged)));
    let (_folder, path) = write(&pcap(&packets));
    let capture = Capture::open(&path).unwrap();
    assert_eq!((capture.bad_packets(), capture.revolutions().len()), (1, 2));
    assert_eq!(capture.revolutions()[0].grid.rows, 1800 - 2 * 24, "two packets of firings are not there");
}

#[test]
fn what_is_no_capture_of_such_a_laser_is_named() {
    let error = |bytes: &[u8]| {
        let (_folder, path) = write(bytes);
        Capture::open(&path).unwrap_err().to_string()
    };
    assert!(error(b"ply\nformat ascii 1.0\n and more").contains("not a readable capture"));
    assert!(error(b"").contains("drive.pcap"));
    assert!(error(&pcap(&[(0, ethernet(b"hello"))])).contains("of 1 packets none is a data packet"));
    let alien = packet(0x28, &[0; 12], |_, _| 1.0);
    assert!(error(&pcap(&[(0, ethernet(&alien))])).contains("another model (code 0x28)"));
    assert!(error(&pcap(&turning(20))).contains("no whole revolution"));
    let mut token_ring = pcap(&turning(200));
    token_ring[20] = 6;
    assert!(error(&token_ring).contains("link type 6"));
    assert!(Capture::open(Path::new("nowhere.pcap")).unwrap_err().to_string().contains("nowhere.pcap"));
}

#[test]
fn a_capture_that_was_cut_off_ends_at_its_last_whole_packet() {
    let whole = pcap(&turning(200));
    let (_folder, path) = write(&whole[..whole.len() - 700]);
    assert_eq!(Capture::open(&path).unwrap().revolutions().len(), 2);
}

#[test]
fn a_capture_that_changes_is_noticed() {
    let (_folder, path) = write(&pcap(&turning(200)));
    let capture = Capture::open(&path).unwrap();
    std::fs::write(&path, pcap(&turning(90))).unwrap();
    let revolution = capture.revolutions()[0];
    let mut out = vec![Point::EMPTY; revolution.grid.cells()];
    assert!(capture.read(&revolution, &mut out).unwrap_err().to_string().contains("changed"));
    assert!(capture.read(&revolution, &mut out[1..]).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn any_damage_is_read_or_refused(flips in prop::collection::vec((0..250_000usize, any::<u8>()), 1..40), cut in 0..250_000usize) {
        let mut bytes = pcap(&turning(180));
        for (at, value) in flips {
            let at = at % bytes.len();
            bytes[at] = value;
        }
        bytes.truncate(cut.max(1).min(bytes.len()));
        let (_folder, path) = write(&bytes);
        if let Ok(capture) = Capture::open(&path) {
            for revolution in capture.revolutions() {
                let mut out = vec![Point::EMPTY; revolution.grid.cells()];
                let _ = capture.read(revolution, &mut out);
                prop_assert!(out.iter().all(|p| !p.is_return() || p.range() < 140.0));
            }
        }
    }
}
