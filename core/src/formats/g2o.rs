//! Pose graphs as g2o text files: `VERTEX_SE3:QUAT id x y z qx qy qz qw`, `EDGE_SE3:QUAT from to x y z qx qy qz qw` and
//! the 21 values of the upper triangle of the information, row by row (Kuemmerle et al. 2011).
//!
//! A g2o residual is the translation and the vector part of the quaternion of measured^-1 * from^-1 * to; ours is its
//! logarithm. To first order the rotation vector is twice the quaternion's vector part, so information about rotation
//! is divided by 2 for each rotation it belongs to on the way in, and multiplied on the way out.

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::{Matrix6, Quaternion, Translation3, UnitQuaternion, Vector6};

use super::error::{FormatError, WriteError};
use super::source::{Source, quoted};
use super::writers::TemporaryFile;
use crate::geometry::Pose;
use crate::slam6d::pose_graph::{Edge, EdgeError, EdgeKind};

/// How far the norm of a quaternion may be from 1.
const UNIT_TOLERANCE: f64 = 1e-2;
/// The fields of a pose.
const POSE_FIELDS: [&str; 7] = ["x", "y", "z", "qx", "qy", "qz", "qw"];
/// The values of an information's upper triangle.
const UPPER: usize = 21;

/// A pose graph as a file describes it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct G2oGraph {
    /// The poses `map_from_node`, in the order of their identifiers.
    pub poses: Vec<Pose>,
    /// The identifiers that the file gives them, ascending.
    pub ids: Vec<u64>,
    /// The measurements, between indices of `poses`. The file does not tell their kinds: those between successive nodes
    /// are taken for [`EdgeKind::Sequential`], all others for [`EdgeKind::LoopClosure`].
    pub edges: Vec<Edge>,
}

/// Reads a pose graph of `VERTEX_SE3:QUAT`, `EDGE_SE3:QUAT` and `FIX` lines; a `.gz` after the name is unpacked.
/// `FIX` lines are passed over: our graphs hold their first node.
///
/// # Errors
/// File, line and field of what is wrong.
pub fn read_g2o(path: &Path) -> Result<G2oGraph, FormatError> {
    let mut source = Source::open(path)?;
    let mut vertices: BTreeMap<u64, Pose> = BTreeMap::new();
    // Edges may stand before their vertices.
    let mut waiting: Vec<WaitingEdge> = Vec::new();
    while source.next_data_line()? {
        let tag = source.tokens().next().unwrap_or_default().to_vec();
        match tag.as_slice() {
            b"VERTEX_SE3:QUAT" => {
                let [id] = identifiers(&source, ["the vertex's identifier"])?;
                let pose = pose(&source, 2)?;
                expect_end(&source, 2 + POSE_FIELDS.len())?;
                if vertices.insert(id, pose).is_some() {
                    let found = format!("{id}, which an earlier line has");
                    return Err(source.malformed_line("the vertex's identifier", found, "one for each vertex"));
                }
            }
            b"EDGE_SE3:QUAT" => waiting.push(WaitingEdge::read(&source)?),
            b"FIX" => {}
            other => {
                let expected = "VERTEX_SE3:QUAT, EDGE_SE3:QUAT or FIX (graphs in space)";
                return Err(source.malformed_line("the tag", quoted(other), expected));
            }
        }
    }
    if vertices.is_empty() {
        return Err(source.truncated("VERTEX_SE3:QUAT lines, of which there is none".into()));
    }
    let ids: Vec<u64> = vertices.keys().copied().collect();
    let edges = waiting.into_iter().map(|edge| edge.place(path, &ids)).collect::<Result<_, _>>()?;
    Ok(G2oGraph { poses: vertices.into_values().collect(), ids, edges })
}

/// An edge between identifiers.
struct WaitingEdge {
    line: u64,
    ends: [u64; 2],
    from_from_to: Pose,
    information: Matrix6<f64>,
}

impl WaitingEdge {
    fn read(source: &Source) -> Result<Self, FormatError> {
        let ends = identifiers(source, ["the edge's first vertex", "the edge's second vertex"])?;
        let from_from_to = pose(source, 3)?;
        let mut tokens = source.tokens().skip(3 + POSE_FIELDS.len());
        let mut information = Matrix6::zeros();
        for (i, j) in (0..6).flat_map(|i| (i..6).map(move |j| (i, j))) {
            let value = finite(source, tokens.next(), "the information (21 values of the upper triangle)")?;
            information[(i, j)] = value;
            information[(j, i)] = value;
        }
        expect_end(source, 3 + POSE_FIELDS.len() + UPPER)?;
        Ok(Self { line: source.line_number(), ends, from_from_to, information: information_in(&information) })
    }

    /// The edge between the indices of its vertices.
    fn place(self, path: &Path, ids: &[u64]) -> Result<Edge, FormatError> {
        let malformed = |field, found: String, expected: &str| FormatError::Malformed {
            path: path.to_path_buf(),
            at: super::At::Line(self.line),
            field,
            found,
            expected: expected.into(),
        };
        let [from, to] = self.ends.map(|id| ids.binary_search(&id).map_err(|_| id));
        let (Ok(from), Ok(to)) = (from, to) else {
            let unknown = from.err().or(to.err()).unwrap_or_default();
            return Err(malformed("the edge's vertex", unknown.to_string(), "a vertex of the file"));
        };
        let kind = if from.abs_diff(to) == 1 { EdgeKind::Sequential } else { EdgeKind::LoopClosure };
        let edge = Edge { from, to, from_from_to: self.from_from_to, information: self.information, kind };
        match edge.check(ids.len()) {
            Ok(()) => Ok(edge),
            Err(EdgeError::SelfEdge { .. }) => {
                Err(malformed("the edge's vertices", self.ends[0].to_string(), "two different vertices"))
            }
            Err(_) => {
                let found = format!("{:?}", self.information.diagonal().as_slice());
                Err(malformed("the information, with the diagonal", found, "positive semidefinite"))
            }
        }
    }
}

/// Writes a pose graph, such as [`read_g2o`] reads. Seventeen digits: what is read again is the same.
///
/// # Errors
/// The disk.
pub fn write_g2o(path: &Path, poses: &[Pose], edges: &[Edge]) -> Result<(), WriteError> {
    let mut file = TemporaryFile::create(path)?;
    for (id, pose) in poses.iter().enumerate() {
        file.write(format!("VERTEX_SE3:QUAT {id} {}\n", pose_text(pose)).as_bytes())?;
    }
    for edge in edges {
        let information = information_out(&edge.information);
        let upper = (0..6).flat_map(|i| (i..6).map(move |j| (i, j))).map(|at| format!(" {:?}", information[at]));
        let pose = pose_text(&edge.from_from_to);
        let line = format!("EDGE_SE3:QUAT {} {} {pose}{}\n", edge.from, edge.to, upper.collect::<String>());
        file.write(line.as_bytes())?;
    }
    file.publish()
}

/// The sum of e^T Omega e with g2o's own residual, so that it can be compared with what g2o prints.
#[must_use]
pub fn g2o_chi2(poses: &[Pose], edges: &[Edge]) -> f64 {
    let chi2 = |edge: &Edge| {
        let (from, to) = (poses.get(edge.from)?, poses.get(edge.to)?);
        let difference = edge.from_from_to.inverse() * from.inverse() * to;
        let (t, q) = (difference.translation.vector, difference.rotation.quaternion());
        let vector = q.imag() * q.w.signum();
        let e = Vector6::new(t.x, t.y, t.z, vector.x, vector.y, vector.z);
        Some(e.dot(&(information_out(&edge.information) * e)))
    };
    edges.iter().filter_map(chi2).sum()
}

/// Information about (translation, rotation vector) from that about (translation, vector part of the quaternion).
fn information_in(information: &Matrix6<f64>) -> Matrix6<f64> {
    scaled(information, 0.5)
}

/// The reverse of [`information_in`].
fn information_out(information: &Matrix6<f64>) -> Matrix6<f64> {
    scaled(information, 2.0)
}

fn scaled(information: &Matrix6<f64>, rotation: f64) -> Matrix6<f64> {
    let factor = |k: usize| if k < 3 { 1.0 } else { rotation };
    Matrix6::from_fn(|i, j| information[(i, j)] * factor(i) * factor(j))
}

fn pose_text(pose: &Pose) -> String {
    let (t, q) = (pose.translation.vector, pose.rotation.quaternion());
    format!("{:?} {:?} {:?} {:?} {:?} {:?} {:?}", t.x, t.y, t.z, q.i, q.j, q.k, q.w)
}

/// The identifiers after the tag.
fn identifiers<const N: usize>(source: &Source, fields: [&'static str; N]) -> Result<[u64; N], FormatError> {
    let mut tokens = source.tokens().skip(1);
    let mut ids = [0; N];
    for (id, field) in ids.iter_mut().zip(fields) {
        let token = tokens.next().unwrap_or_default();
        let parsed = std::str::from_utf8(token).ok().and_then(|text| text.parse().ok());
        *id = parsed.ok_or_else(|| source.malformed_line(field, quoted(token), "a whole number"))?;
    }
    Ok(ids)
}

/// The pose that begins after `skip` values.
fn pose(source: &Source, skip: usize) -> Result<Pose, FormatError> {
    let mut tokens = source.tokens().skip(skip);
    let mut values = [0.0; 7];
    for (value, field) in values.iter_mut().zip(POSE_FIELDS) {
        *value = finite(source, tokens.next(), field)?;
    }
    let [x, y, z, qx, qy, qz, qw] = values;
    let quaternion = Quaternion::new(qw, qx, qy, qz);
    if (quaternion.norm() - 1.0).abs() > UNIT_TOLERANCE {
        let found = format!("of length {:.4}", quaternion.norm());
        return Err(source.malformed_line("the quaternion (qw last)", found, "of length 1 within 0.01"));
    }
    Ok(Pose::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_quaternion(quaternion)))
}

fn finite(source: &Source, token: Option<&[u8]>, field: &'static str) -> Result<f64, FormatError> {
    let token = token.ok_or_else(|| source.malformed_line(field, "missing".into(), "a number"))?;
    let value = source.number(token, field)?;
    if value.is_finite() { Ok(value) } else { Err(source.malformed_line(field, quoted(token), "a finite number")) }
}

fn expect_end(source: &Source, columns: usize) -> Result<(), FormatError> {
    let found = source.tokens().count();
    if found == columns {
        return Ok(());
    }
    let expected = format!("{columns}, the tag among them");
    Err(source.malformed_line("the number of columns", found.to_string(), &expected))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use proptest::prelude::*;

    use super::*;
    use crate::geometry::{Twist, exp};
    use crate::slam6d::pose_graph::{PoseGraph, PoseGraphConfig};
    use crate::test_data::data;

    fn read(text: &[u8]) -> Result<G2oGraph, FormatError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("graph.g2o");
        fs::write(&path, text).unwrap();
        read_g2o(&path)
    }

    const VERTICES: &str = "VERTEX_SE3:QUAT 7 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 3 1 2 3 0 0 0 1\n";

    fn edge(ends: &str, upper: &str) -> String {
        format!("{VERTICES}EDGE_SE3:QUAT {ends} 1 0 0 0 0 0 1 {upper}\n")
    }

    const IDENTITY: &str = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 4 0 0 4 0 4";

    #[test]
    fn vertices_are_ordered_by_identifier_and_edges_follow() {
        let graph = read(edge("7 3", IDENTITY).as_bytes()).unwrap();
        assert_eq!(graph.ids, [3, 7]);
        assert_eq!(graph.poses[0].translation.vector, nalgebra::Vector3::new(1.0, 2.0, 3.0));
        assert_eq!((graph.edges[0].from, graph.edges[0].to), (1, 0));
        // Four for half an angle is one for the angle.
        assert_eq!(graph.edges[0].information, Matrix6::identity());
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        let negative = IDENTITY.replacen('1', "-1", 1);
        let infinite = IDENTITY.replacen('1', "inf", 1);
        let cases = [
            (edge("7 4", IDENTITY), "line 3: the edge's vertex is 4"),
            (edge("7 7", IDENTITY), "line 3: the edge's vertices is 7"),
            (edge("7 x", IDENTITY), "line 3: the edge's second vertex is \"x\""),
            (edge("7 3", &negative), "line 3: the information"),
            (edge("7 3", &infinite), "line 3: the information"),
            (edge("7 3", "1 0 0"), "line 3: the information (21 values of the upper triangle) is missing"),
            (edge("7 3", &format!("{IDENTITY} 9")), "line 3: the number of columns is 32"),
            (format!("{VERTICES}VERTEX_SE3:QUAT 3 0 0 0 0 0 0 1"), "line 3: the vertex's identifier is 3"),
            (format!("{VERTICES}VERTEX_SE3:QUAT 4 0 0 nan 0 0 0 1"), "line 3: z is"),
            (format!("{VERTICES}VERTEX_SE3:QUAT 4 0 0 0 0 0 0 2"), "line 3: the quaternion"),
            (format!("{VERTICES}VERTEX_SE2 4 0 0 0"), "line 3: the tag is \"VERTEX_SE2\""),
        ];
        for (text, expected) in cases {
            let message = read(text.as_bytes()).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}\nshould have {expected}");
        }
        assert!(matches!(read(b"# nothing\n"), Err(FormatError::Truncated { .. })));
    }

    proptest! {
        #[test]
        fn what_is_written_is_read_again(
            twists in prop::collection::vec(prop::array::uniform6(-2.0..2.0f64), 3),
            values in prop::array::uniform6(0.1..9.0f64),
        ) {
            let poses: Vec<Pose> = twists.iter().map(|t| exp(&Twist::from(*t))).collect();
            let root = Matrix6::from_fn(|i, j| values[(i + 2 * j) % 6] - if i == j { 0.0 } else { 4.0 });
            let information = root * root.transpose();
            let information = (information + information.transpose()) * 0.5;
            let edges = [(0, 1), (2, 0)].map(|(from, to)| Edge {
                from,
                to,
                from_from_to: poses[from].inverse() * poses[to],
                information,
                kind: if to == 1 { EdgeKind::Sequential } else { EdgeKind::LoopClosure },
            });
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("graph.g2o");
            write_g2o(&path, &poses, &edges).unwrap();
            let graph = read_g2o(&path).unwrap();
            // A quaternion is brought to unit length when it is read, which may change its last bit.
            for (a, b) in graph.poses.iter().zip(&poses) {
                prop_assert!((a.to_homogeneous() - b.to_homogeneous()).amax() < 1e-14);
            }
            for (a, b) in graph.edges.iter().zip(&edges) {
                prop_assert_eq!((a.from, a.to, a.kind), (b.from, b.to, b.kind));
                prop_assert_eq!(a.information, b.information);
            }
        }

        #[test]
        fn arbitrary_text_never_panics(text in "(VERTEX_SE3:QUAT|EDGE_SE3:QUAT|FIX)?[ 0-9a-z.\\-\n]{0,120}") {
            let _ = read(text.as_bytes());
        }
    }

    /// From PyPI on the same file: g2o-python 0.0.12 (Gauss-Newton, 10 iterations) ends at 1.238690579754; GTSAM 4.3.0
    /// (Gauss-Newton, tolerances of 1e-14) at twice the error 0.634192399632, and it takes the information for that
    /// about rotation vectors, as it stands in the file.
    #[test]
    fn the_parking_garage_reaches_the_optima_of_g2o_and_gtsam() {
        let Some(folder) = data("parking garage", "posegraph") else { return };
        let read = read_g2o(&folder.join("parking-garage.g2o.gz")).unwrap();
        assert_eq!((read.poses.len(), read.edges.len()), (1661, 6275));
        assert!((g2o_chi2(&read.poses, &read.edges) / 16_720.018_170_518_3 - 1.0).abs() < 1e-9);
        for as_gtsam in [false, true] {
            let mut graph = PoseGraph::new(PoseGraphConfig::default()).unwrap();
            read.poses.iter().for_each(|pose| {
                graph.add_node(*pose);
            });
            for edge in &read.edges {
                let information = if as_gtsam { information_out(&edge.information) } else { edge.information };
                graph.add_edge(Edge { information, ..edge.clone() }).unwrap();
            }
            let result = graph.optimise().unwrap();
            let (found, known) = if as_gtsam {
                (result.chi2, 1.268_384_799_264)
            } else {
                (g2o_chi2(graph.poses(), &read.edges), 1.238_690_579_754)
            };
            println!("parking garage: {result:?}, {found:.12} in the convention of the peer, which has {known:.12}");
            assert!(result.converged && result.switched_off.is_empty(), "{result:?}");
            assert!((found / known - 1.0).abs() < 1e-9, "{found:.12} instead of {known:.12}");
        }
    }
}
