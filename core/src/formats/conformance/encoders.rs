//! Test files of every format, written without the code under test.

use crate::scan::Point;
use std::fmt::Write as _;

/// What a format can express beside positions.
#[derive(PartialEq)]
pub(super) enum Keeps {
    Intensity,
    EmptyCells,
}

/// One row of the table of formats.
pub(super) struct Case {
    pub(super) name: &'static str,
    pub(super) encode: fn(&[Point]) -> Vec<u8>,
    pub(super) keeps: &'static [Keeps],
    pub(super) tolerance_m: f32,
}

const BOTH: &[Keeps] = &[Keeps::Intensity, Keeps::EmptyCells];

pub(super) const CASES: &[Case] = &[
    Case { name: "four.3d", encode: tdtk, keeps: BOTH, tolerance_m: 1e-5 },
    Case { name: "raw.xyz32.bin", encode: xyz32, keeps: &[Keeps::EmptyCells], tolerance_m: 0.0 },
    Case { name: "kitti.bin", encode: kitti, keeps: BOTH, tolerance_m: 0.0 },
    Case { name: "ascii.pcd", encode: |p| pcd(p, "ascii"), keeps: BOTH, tolerance_m: 1e-5 },
    Case { name: "binary.pcd", encode: |p| pcd(p, "binary"), keeps: BOTH, tolerance_m: 0.0 },
    Case { name: "packed.pcd", encode: |p| pcd(p, "binary_compressed"), keeps: BOTH, tolerance_m: 0.0 },
    Case { name: "ascii.ply", encode: |p| ply(p, "ascii"), keeps: BOTH, tolerance_m: 1e-5 },
    Case { name: "little.ply", encode: |p| ply(p, "binary_little_endian"), keeps: BOTH, tolerance_m: 0.0 },
    Case { name: "big.ply", encode: |p| ply(p, "binary_big_endian"), keeps: BOTH, tolerance_m: 0.0 },
    Case { name: "a.las", encode: |p| las(p, 0, false), keeps: &[Keeps::Intensity], tolerance_m: 1e-3 },
    Case { name: "classic.laz", encode: |p| las(p, 0, true), keeps: &[Keeps::Intensity], tolerance_m: 1e-3 },
    Case { name: "layered.laz", encode: |p| las(p, 6, true), keeps: &[Keeps::Intensity], tolerance_m: 1e-3 },
    Case { name: "named.csv", encode: csv, keeps: BOTH, tolerance_m: 1e-5 },
    Case { name: "ascii.vtk", encode: |p| vtk(p, "ASCII"), keeps: &[Keeps::EmptyCells], tolerance_m: 1e-5 },
    Case { name: "binary.vtk", encode: |p| vtk(p, "BINARY"), keeps: &[Keeps::EmptyCells], tolerance_m: 0.0 },
];

fn tdtk(points: &[Point]) -> Vec<u8> {
    let mut text = String::new();
    for p in points {
        let (x, y, z) = (-p.y * 100.0, p.z * 100.0, p.x * 100.0);
        writeln!(text, "{x} {y} {z} {}", p.intensity).unwrap();
    }
    text.into_bytes()
}

fn xyz32(points: &[Point]) -> Vec<u8> {
    points.iter().flat_map(|p| [p.x, p.y, p.z]).flat_map(f32::to_le_bytes).collect()
}

fn kitti(points: &[Point]) -> Vec<u8> {
    let floats = points.iter().flat_map(|p| [p.x, p.y, p.z, f32::from(p.intensity) / 65535.0]);
    floats.flat_map(f32::to_le_bytes).collect()
}

/// Fields in an unusual order, with one that is not known and one of three values.
fn pcd(points: &[Point], data: &str) -> Vec<u8> {
    let n = points.len();
    let mut out = format!(
        "# .PCD v.7\nVERSION .7\nFIELDS intensity normal x y z ring\nSIZE 2 4 4 4 4 1\nTYPE U F F F F U\n\
         COUNT 1 3 1 1 1 1\nWIDTH {n}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA {data}\n"
    )
    .into_bytes();
    let fields: [fn(&Point) -> Vec<u8>; 6] = [
        |p| p.intensity.to_le_bytes().to_vec(),
        |_| [7_f32, 8.0, 9.0].into_iter().flat_map(f32::to_le_bytes).collect(),
        |p| p.x.to_le_bytes().to_vec(),
        |p| p.y.to_le_bytes().to_vec(),
        |p| p.z.to_le_bytes().to_vec(),
        |_| vec![200],
    ];
    match data {
        "ascii" => {
            let line = |p: &Point| format!("{} 7 8 9 {} {} {} 200\n", p.intensity, p.x, p.y, p.z).into_bytes();
            out.extend(points.iter().flat_map(line));
        }
        "binary" => out.extend(points.iter().flat_map(|p| fields.iter().flat_map(move |f| f(p)))),
        _ => {
            let planes: Vec<u8> = fields.iter().flat_map(|f| points.iter().flat_map(f)).collect();
            // LZF of literals only, which every decoder takes.
            let packed: Vec<u8> = planes.chunks(32).flat_map(|run| [&[run.len() as u8 - 1], run].concat()).collect();
            out.extend((packed.len() as u32).to_le_bytes());
            out.extend((planes.len() as u32).to_le_bytes());
            out.extend(packed);
        }
    }
    out
}

/// An element with a list before the vertices, a list inside them, and one after them.
fn ply(points: &[Point], format: &str) -> Vec<u8> {
    let n = points.len();
    let mut out = format!(
        "ply\nformat {format} 1.0\ncomment made by hand\nelement camera 2\nproperty list uchar int ids\n\
         property double focal\nelement vertex {n}\nproperty uchar ring\nproperty float x\nproperty float y\n\
         property list ushort short echoes\nproperty float z\nproperty ushort intensity\nelement face 1\n\
         property list uchar uint vertex_indices\nend_header\n"
    )
    .into_bytes();
    if format == "ascii" {
        out.extend(b"2 5 6 1.5\n0 2.5\n");
        for p in points {
            out.extend(format!("9 {} {} 2 -1 -2 {} {}\n", p.x, p.y, p.z, p.intensity).into_bytes());
        }
        out.extend(b"1 0\n");
        return out;
    }
    let is_big = format.ends_with("big_endian");
    let mut put = |mut le: Vec<u8>| {
        if is_big {
            le.reverse();
        }
        out.extend(le);
    };
    for (ids, focal) in [(vec![5_i32, 6], 1.5_f64), (vec![], 2.5)] {
        put(vec![ids.len() as u8]);
        ids.iter().for_each(|id| put(id.to_le_bytes().into()));
        put(focal.to_le_bytes().into());
    }
    for p in points {
        put(vec![9]);
        put(p.x.to_le_bytes().into());
        put(p.y.to_le_bytes().into());
        put(2_u16.to_le_bytes().into());
        put((-1_i16).to_le_bytes().into());
        put((-2_i16).to_le_bytes().into());
        put(p.z.to_le_bytes().into());
        put(p.intensity.to_le_bytes().into());
    }
    put(vec![1]);
    put(0_u32.to_le_bytes().into());
    out
}

fn las(points: &[Point], format: u8, is_compressed: bool) -> Vec<u8> {
    let mut builder = las::Builder::from((1, if format < 6 { 2 } else { 4 }));
    builder.point_format = las::point::Format::new(format).unwrap();
    builder.point_format.is_compressed = is_compressed;
    let header = builder.into_header().unwrap();
    let mut writer = las::Writer::new(std::io::Cursor::new(Vec::new()), header).unwrap();
    for p in points {
        let record = las::Point {
            x: p.x.into(),
            y: p.y.into(),
            z: p.z.into(),
            intensity: p.intensity,
            gps_time: (format == 6).then_some(0.0),
            ..Default::default()
        };
        writer.write_point(record).unwrap();
    }
    writer.into_inner().unwrap().into_inner()
}

fn csv(points: &[Point]) -> Vec<u8> {
    let mut text = String::from("ring, Y, \"x\", z, Intensity\r\n");
    for p in points {
        write!(text, "3, {}, {}, {}, {}\r\n", p.y, p.x, p.z, p.intensity).unwrap();
    }
    text.into_bytes()
}

fn vtk(points: &[Point], kind: &str) -> Vec<u8> {
    let n = points.len();
    let mut out =
        format!("# vtk DataFile Version 3.0\na title\n{kind}\nDATASET POLYDATA\nPOINTS {n} float\n").into_bytes();
    if kind == "BINARY" {
        out.extend(points.iter().flat_map(|p| [p.x, p.y, p.z]).flat_map(f32::to_be_bytes));
    } else {
        // Three points a line, as VTK itself writes.
        for three in points.chunks(3) {
            let values: Vec<String> = three.iter().flat_map(|p| [p.x, p.y, p.z]).map(|v| v.to_string()).collect();
            out.extend(values.join(" ").into_bytes());
            out.push(b'\n');
        }
    }
    out.extend(format!("\nVERTICES {n} {}\n", 2 * n).into_bytes());
    out
}
