//! Relaxation of simulated and real scans.

use std::time::Instant;

use nalgebra::Vector3;

use super::*;
use crate::registration::test_scenes::{YARD, data, read_tum, read_xyz32, scan_of};
use crate::registration::{Limits, Registration, RegistrationConfig, Registry};
use crate::scan::{Point, ScanView};
use crate::slam6d::pose_graph::{Edge, EdgeKind, PoseGraph, PoseGraphConfig};
use crate::slam6d::trajectory_error;

fn prepare(scans: &[Vec<Point>]) -> Vec<PreparedCloud> {
    let config = RegistrationConfig { threads: 2, ..RegistrationConfig::default() };
    scans.iter().map(|scan| PreparedCloud::new(ScanView::unordered(scan), &config).unwrap()).collect()
}

/// Six places in the yard, scans from there, and poses off by up to 0.15 m and 1.5 degrees but for the first.
fn yard() -> (Vec<Pose>, Vec<PreparedCloud>, Vec<Pose>) {
    let truth: Vec<Pose> = (0..6)
        .map(|k| {
            let angle = f64::from(k) * 0.9;
            Pose::new(Vector3::new(2.0 * angle.cos() - 2.0, 2.0 * angle.sin(), 0.1), Vector3::z() * angle)
        })
        .collect();
    let scans: Vec<_> = truth.iter().zip(1..).map(|(pose, seed)| scan_of(&YARD, pose, 40.0, seed)).collect();
    let off = |k: usize| {
        let sign = |bit: usize| if (5 * k + k * k) >> bit & 1 == 0 { 1.0 } else { -1.0 };
        let turn = 0.015 * Vector3::new(sign(2), sign(0), sign(1));
        Pose::new(0.08 * Vector3::new(sign(0), sign(1), sign(2)), turn)
    };
    let start = truth.iter().enumerate().map(|(k, pose)| if k == 0 { *pose } else { pose * off(k) }).collect();
    (truth, prepare(&scans), start)
}

#[test]
fn scans_of_a_yard_fall_into_place_at_once_and_the_first_stays() {
    let (truth, clouds, start) = yard();
    let clouds: Vec<_> = clouds.iter().collect();
    let mut results = Vec::new();
    for threads in [1, 2, 3] {
        let mut poses = start.clone();
        let config = RelaxationConfig { threads, stride: 1, ..RelaxationConfig::default() };
        let result = relax(&clouds, &mut poses, &config).unwrap();
        let (before, after) = (trajectory_error(&start, &truth).unwrap(), trajectory_error(&poses, &truth).unwrap());
        println!("yard: {result:?}\n  from {before:?}\n  to {after:?}");
        assert!(result.converged && result.scan_pairs == 15 && result.residual_m < 0.5 * result.residual_before_m);
        assert!(before.ate_rmse_m > 0.1 && after.max_m < 0.01 && after.max_deg < 0.1, "{after:?}");
        assert_eq!(poses[0], start[0]);
        results.push((poses, result));
    }
    assert!(results.iter().all(|result| *result == results[0]), "the number of threads makes no difference");
}

#[test]
fn a_scan_that_overlaps_no_other_stays() {
    let (_, mut clouds, mut poses) = yard();
    let slab = scan_of(&[([-6.0, -6.0, 8.0], [12.0, 0.0, 0.0], [0.0, 12.0, 2.0])], &Pose::identity(), 40.0, 9);
    clouds.extend(prepare(&[slab]));
    poses.push(Pose::translation(0.5, 0.0, 0.0));
    let result = relax(&clouds.iter().collect::<Vec<_>>(), &mut poses, &RelaxationConfig::default()).unwrap();
    assert!(result.converged && result.scan_pairs == 15, "{result:?}");
    assert_eq!(poses[6], Pose::translation(0.5, 0.0, 0.0));
}

#[test]
fn a_question_that_makes_no_sense_is_refused() {
    let (_, clouds, mut poses) = yard();
    let clouds: Vec<_> = clouds.iter().collect();
    let config = RelaxationConfig::default();
    assert_eq!(relax(&clouds[1..], &mut poses, &config), Err(RelaxationError::Count { scans: 5, poses: 6 }));
    let wrong = RelaxationConfig { min_overlap: 2.0, ..config };
    assert!(matches!(relax(&clouds, &mut poses, &wrong), Err(RelaxationError::Config(_))));
    poses[3].translation.vector.x = f64::NAN;
    assert_eq!(relax(&clouds, &mut poses, &config), Err(RelaxationError::NotFinite { scan: 3 }));
    let nothing = relax(&[], &mut [], &config).unwrap();
    assert!(nothing.converged && nothing.scan_pairs == 0);
}

/// The real walk: the chain of pairs, then relaxation, then a pose graph of separately aligned pairs.
///
/// The reference poses are those of the odometry that recorded the walk: good to millimetres from scan to scan, but
/// where the walk comes back after 30 m and 60 m they disagree with the scans by 0.05 to 0.13 m. Pairwise GICP of
/// all 292 pairs within 8 m by small_gicp and a graph of them by GTSAM end 0.114 m and 0.143 degrees from the
/// reference, and within 8 mm and 0.04 degrees of where relaxation ends. So what is asserted of the positions is that
/// everything ends in the same place, wherever it starts, and that the scans fit better there than at the reference.
#[test]
fn the_handheld_walk_relaxes_to_one_place_from_everywhere() {
    let Some(path) = data("handheld relaxation", "handheld") else { return };
    let (odometry, reference) = (read_tum(&path.join("odometry.tum")), read_tum(&path.join("poses.tum")));
    let scans: Vec<_> = (0..45).map(|k| read_xyz32(&path.join(format!("scan{:03}.xyz32.bin", 4 * k)))).collect();
    let begin = Instant::now();
    let mut registration =
        Registry::default().create("point_to_plane", &RegistrationConfig { threads: 2, ..Default::default() }).unwrap();
    let clouds = prepare(&scans);
    let chain = chain_of(&mut *registration, &clouds, &odometry);
    println!("chain in {:?}: {:?}", begin.elapsed(), trajectory_error(&chain, &reference));
    let clouds: Vec<_> = clouds.iter().collect();
    let config = RelaxationConfig { threads: 2, ..RelaxationConfig::default() };
    let mut relaxed = chain.clone();
    let result = relax(&clouds, &mut relaxed, &config).unwrap();
    let error = trajectory_error(&relaxed, &reference).unwrap();
    println!("relaxed after {:?}: {result:?}\n  {error:?}", begin.elapsed());
    assert!(result.converged && error.ate_rmse_deg < 0.16 && error.ate_rmse_m < 0.12, "{error:?}");

    let mut from_reference = reference.clone();
    let other = relax(&clouds, &mut from_reference, &config).unwrap();
    let apart = trajectory_error(&from_reference, &relaxed).unwrap();
    println!("from the reference: {other:?}\n  {apart:?}");
    assert!(apart.ate_rmse_m < 0.005 && apart.ate_rmse_deg < 0.02, "{apart:?}");
    assert!(other.residual_before_m > 1.05 * other.residual_m, "the scans fit better than at the reference");

    let graph = graph_of(&mut *registration, &clouds, &chain);
    let apart = trajectory_error(graph.poses(), &relaxed).unwrap();
    println!("graph of {} pairs: {:?}\n  {apart:?}", graph.edges().len(), trajectory_error(graph.poses(), &reference));
    assert!(apart.ate_rmse_m < 0.015 && apart.ate_rmse_deg < 0.1, "{apart:?}");
}

fn chain_of(registration: &mut dyn Registration, clouds: &[PreparedCloud], odometry: &[Pose]) -> Vec<Pose> {
    let mut chain = vec![odometry[0]];
    for k in 1..clouds.len() {
        let start = odometry[k - 1].inverse() * odometry[k];
        let found = registration.align(&clouds[k - 1], &clouds[k], &start, &Limits::default()).unwrap();
        chain.push(chain[k - 1] * found.target_from_source);
    }
    chain
}

/// A pose graph of all pairs within 5 m, each aligned by itself, weighed by its covariance.
fn graph_of(registration: &mut dyn Registration, clouds: &[&PreparedCloud], poses: &[Pose]) -> PoseGraph {
    let mut graph = PoseGraph::new(PoseGraphConfig::default()).unwrap();
    for (j, pose) in poses.iter().enumerate() {
        graph.add_node(*pose);
        for i in 0..j {
            let start = poses[i].inverse() * pose;
            if start.translation.vector.norm() > 5.0 {
                continue;
            }
            let limits = Limits { pair_distance_m: 0.5, ..Limits::default() };
            let found = registration.align(clouds[i], clouds[j], &start, &limits).unwrap();
            let kind = if i + 1 == j { EdgeKind::Sequential } else { EdgeKind::LoopClosure };
            if i + 1 == j || (found.converged && found.overlap > 0.3) {
                let (motion, covariance) = (found.target_from_source, found.covariance);
                graph.add_edge(Edge::with_covariance(i, j, motion, &covariance, kind).unwrap()).unwrap();
            }
        }
    }
    let result = graph.optimise().unwrap();
    assert!(result.converged && result.switched_off.is_empty(), "{result:?}");
    graph
}
