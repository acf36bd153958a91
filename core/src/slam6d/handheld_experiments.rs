//! Scratch.
use std::time::Instant;

use super::pose_graph::*;
use super::*;
use crate::geometry::{Pose, log, rotation_angle};
use crate::registration::test_scenes::{data, read_tum, read_xyz32};
use crate::registration::*;
use crate::scan::{Point, ScanView};

fn load() -> (Vec<Vec<Point>>, Vec<Pose>, Vec<Pose>) {
    let path = data("experiments", "handheld").unwrap();
    let scans = (0..45).map(|k| read_xyz32(&path.join(format!("scan{:03}.xyz32.bin", 4 * k)))).collect();
    (scans, read_tum(&path.join("odometry.tum")), read_tum(&path.join("poses.tum")))
}

fn env(name: &str, default: f64) -> f64 {
    std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(default)
}

pub fn rmse_by_best_fit(estimate: &[Pose], truth: &[Pose]) -> (f64, f64) {
    // Kabsch on positions.
    let n = estimate.len() as f64;
    let ce = estimate.iter().map(|p| p.translation.vector).sum::<nalgebra::Vector3<f64>>() / n;
    let ct = truth.iter().map(|p| p.translation.vector).sum::<nalgebra::Vector3<f64>>() / n;
    let mut h = nalgebra::Matrix3::zeros();
    for (e, t) in estimate.iter().zip(truth) {
        h += (e.translation.vector - ce) * (t.translation.vector - ct).transpose();
    }
    let svd = h.svd(true, true);
    let (u, vt) = (svd.u.unwrap(), svd.v_t.unwrap());
    let mut d = nalgebra::Matrix3::identity();
    d[(2, 2)] = (vt.transpose() * u.transpose()).determinant().signum();
    let r = vt.transpose() * d * u.transpose();
    let mut s = 0.0;
    let mut a = 0.0;
    let rot = nalgebra::UnitQuaternion::from_matrix(&r);
    for (e, t) in estimate.iter().zip(truth) {
        s += (r * (e.translation.vector - ce) - (t.translation.vector - ct)).norm_squared();
        a += (rot * e.rotation).angle_to(&t.rotation).to_degrees().powi(2);
    }
    ((s / n).sqrt(), (a / n).sqrt())
}

#[test]
#[ignore]
fn pairs() {
    let (scans, odometry, truth) = load();
    let mut config = RegistrationConfig { threads: 2, ..RegistrationConfig::default() };
    config.preparation.voxel_m = env("VOXEL", 0.25);
    config.preparation.normal_neighbours = env("NEIGH", 12.0) as usize;
    config.final_pair_distance_m = env("FINAL", 0.5);
    config.robust_scale_m = env("SCALE", 0.1);
    let method = std::env::var("METHOD").unwrap_or("point_to_plane".into());
    let mut registration = Registry::default().create(&method, &config).unwrap();
    let begin = Instant::now();
    let prepared: Vec<_> = scans.iter().map(|s| registration.prepare(ScanView::unordered(s)).unwrap()).collect();
    println!("prepare {:?}, points {}", begin.elapsed(), prepared.iter().map(|p| p.points().len()).sum::<usize>() / 45);
    let limits = Limits::default();
    let mut graph = PoseGraph::new(PoseGraphConfig::default()).unwrap();
    let mut poses = vec![odometry[0]];
    let mut aligned = vec![];
    for k in 1..45 {
        let start = odometry[k - 1].inverse() * odometry[k];
        let a = registration.align(&*prepared[k - 1], &*prepared[k], &start, &limits).unwrap();
        poses.push(poses[k - 1] * a.target_from_source);
        aligned.push((k - 1, k, a));
    }
    println!("chain {:?} at {:?}; best fit {:?}", trajectory_error(&poses, &truth).unwrap(), begin.elapsed(), rmse_by_best_fit(&poses, &truth));
    for p in &poses {
        graph.add_node(*p);
    }
    let radius = env("RADIUS", 8.0);
    let minimum = env("OVERLAP", 0.3);
    let limits = Limits { pair_distance_m: env("PAIR", 1.0), ..limits };
    for i in 0..45 {
        for j in i + 2..45 {
            let start = poses[i].inverse() * poses[j];
            if start.translation.vector.norm() < radius {
                let a = registration.align(&*prepared[i], &*prepared[j], &start, &limits).unwrap();
                aligned.push((i, j, a));
            }
        }
    }
    println!("{} pairs at {:?}", aligned.len(), begin.elapsed());
    let bins = [0.0, 2.5, 4.0, 6.0, 8.0, 10.0, 15.0];
    for w in bins.windows(2) {
        let mut t = vec![];
        let (mut r, mut n, mut used) = (0.0, 0.0, 0);
        let mut bias = nalgebra::Vector6::zeros();
        let mut iters = 0;
        for (i, j, a) in &aligned {
            let true_motion = truth[*i].inverse() * truth[*j];
            let d = true_motion.translation.vector.norm();
            if d < w[0] || d >= w[1] || a.overlap < minimum || !a.converged {
                continue;
            }
            let e = a.target_from_source.inverse() * true_motion;
            t.push(e.translation.vector.norm());
            r += rotation_angle(&e).to_degrees().powi(2);
            let x = log(&e);
            bias += x;
            n += x.dot(&(a.covariance.try_inverse().unwrap() * x));
            iters += a.iterations;
            used += 1;
        }
        t.sort_by(f64::total_cmp);
        if used > 0 {
            let m = f64::from(used);
            println!(
                "  {:.1}-{:.1} m: {used} pairs, t median {:.4} rms {:.4} max {:.3}, rot rms {:.3} deg, nees {:.1}, iterations {:.1}, bias {:.4?}",
                w[0], w[1], t[t.len() / 2], (t.iter().map(|x| x * x).sum::<f64>() / m).sqrt(), t[t.len() - 1], (r / m).sqrt(), n / m, f64::from(iters) / m, (bias / m).as_slice()
            );
        }
    }
    let mut added = 0;
    for (i, j, a) in &aligned {
        if *j == i + 1 || (a.converged && a.overlap >= minimum) {
            let kind = if *j == i + 1 { EdgeKind::Sequential } else { EdgeKind::LoopClosure };
            let mut cov = a.covariance;
            if env("UNIT", 0.0) > 0.0 {
                cov = nalgebra::Matrix6::from_diagonal(&nalgebra::Vector6::new(1e-4, 1e-4, 1e-4, 4e-6, 4e-6, 4e-6));
            }
            graph.add_edge(Edge::with_covariance(*i, *j, a.target_from_source, &cov, kind).unwrap()).unwrap();
            added += 1;
        }
    }
    let t = Instant::now();
    let result = graph.optimise().unwrap();
    println!("graph of {added}: {:?} off {} chi2/dof {:.2} in {:?}", result.converged, result.switched_off.len(), result.chi2 / (6.0 * (added as f64 - 44.0)), t.elapsed());
    for apart in [10, 20, 30] {
        println!("thickness [mm] of those {apart} apart: truth {:?}, chain {:?}, graph {:?}", thickness(&scans, &truth, apart), thickness(&scans, &poses, apart), thickness(&scans, graph.poses(), apart));
    }
    if env("SHOW", 0.0) > 0.0 {
        show(graph.poses(), &truth);
    }
    let reference = read_tum(std::path::Path::new("/tmp/ref_poses_0.15.tum"));
    println!("from independent graph: chain {:?}, graph {:?}", trajectory_error(&poses, &reference), trajectory_error(graph.poses(), &reference));
    println!("graph {:?} at {:?}; best fit {:?}", trajectory_error(graph.poses(), &truth).unwrap(), begin.elapsed(), rmse_by_best_fit(graph.poses(), &truth));
}

pub fn show(estimate: &[Pose], truth: &[Pose]) {
    let fit = truth[0] * estimate[0].inverse();
    for (k, (e, t)) in estimate.iter().zip(truth).enumerate() {
        let p = t.translation.vector;
        let d = (fit * e).translation.vector - p;
        let r = ((fit * e) * t.inverse()).rotation.scaled_axis() * 57.29578;
        println!("{k:2} at {:7.2} {:7.2} {:6.2}  off {:6.3} {:6.3} {:6.3} m  {:6.3} {:6.3} {:6.3} deg", p.x, p.y, p.z, d.x, d.y, d.z, r.x, r.y, r.z);
    }
}

/// Thickness of surfaces seen by scans far apart in time: quartiles of the root of the least eigenvalue.
pub fn thickness(scans: &[Vec<Point>], poses: &[Pose], apart: usize) -> (usize, Vec<f64>) {
    use std::collections::BTreeMap;
    let mut out = vec![];
    for shift in [0.0, 0.33] {
        let mut cells: BTreeMap<[i32; 3], Vec<(usize, nalgebra::Vector3<f64>)>> = BTreeMap::new();
        for (k, (scan, pose)) in scans.iter().zip(poses).enumerate() {
            for p in scan {
                if p.range() < 1.0 || p.range() > 30.0 {
                    continue;
                }
                let q = pose * nalgebra::Point3::new(f64::from(p.x), f64::from(p.y), f64::from(p.z));
                cells.entry([0, 1, 2].map(|a| ((q[a] + shift) / 0.7).floor() as i32)).or_default().push((k, q.coords));
            }
        }
        for points in cells.values() {
            let (lo, hi) = (points[0].0, points[points.len() - 1].0);
            if hi - lo < apart || points.len() < 60 {
                continue;
            }
            let early: Vec<_> = points.iter().filter(|(k, _)| *k < lo + 5).collect();
            let late: Vec<_> = points.iter().filter(|(k, _)| *k + 5 > hi).collect();
            if early.len() < 25 || late.len() < 25 {
                continue;
            }
            let all: Vec<_> = early.iter().chain(&late).map(|(_, p)| *p).collect();
            let n = all.len() as f64;
            let c = all.iter().sum::<nalgebra::Vector3<f64>>() / n;
            let m = all.iter().map(|p| (p - c) * (p - c).transpose()).sum::<nalgebra::Matrix3<f64>>() / n;
            let mut e: Vec<f64> = m.symmetric_eigenvalues().iter().copied().collect();
            e.sort_by(f64::total_cmp);
            if e[0] / e[1] < 0.05 && e[1] / e[2] > 0.1 {
                out.push(e[0].sqrt());
            }
        }
    }
    out.sort_by(f64::total_cmp);
    let n = out.len();
    (n, [0.1, 0.25, 0.5, 0.75, 0.9].iter().map(|q| (out[(q * n as f64) as usize] * 1e4).round() / 10.0).collect())
}

/// Which of two relative poses the points like better, by an objective of its own: full scans, raw nearest points within
/// 0.3 m, planes fitted to 20 raw neighbours that are flat, share of residuals under 2 cm.
#[test]
#[ignore]
fn referee() {
    let (scans, odometry, truth) = load();
    let config = RegistrationConfig { threads: 2, ..RegistrationConfig::default() };
    let mut registration = Registry::default().create("point_to_plane", &config).unwrap();
    let prepared: Vec<_> = scans.iter().map(|s| registration.prepare(ScanView::unordered(s)).unwrap()).collect();
    let trees: Vec<KdTree> = scans.iter().map(|s| KdTree::new(s.iter().filter(|p| p.range() > 1.0 && p.range() < 40.0).map(|p| [p.x, p.y, p.z]).collect())).collect();
    let _ = odometry;
    let (mut wins, mut sum) = (0, [0.0; 2]);
    let mut total = 0;
    for (i, j) in [(0, 5), (0, 6), (1, 6), (2, 7), (27, 44), (28, 43), (26, 42), (29, 42), (27, 43), (8, 14), (9, 30), (10, 31), (0, 30), (0, 31), (20, 25), (21, 26), (22, 24), (34, 41), (33, 43), (3, 30), (5, 32), (10, 14), (11,14), (30, 33), (19, 26), (20, 28), (40, 43)] {
        let start = truth[i].inverse() * truth[j];
        let a = registration.align(&*prepared[i], &*prepared[j], &start, &Limits::default()).unwrap();
        let off = log(&(start.inverse() * a.target_from_source));
        let mut shares = [0.0; 2];
        let mut gradient = [0.0; 2];
        for (w, pose) in [start, a.target_from_source].iter().enumerate() {
            let (mut good, mut count) = (0.0, 0.0);
            let mut near = Neighbours::new(20);
            for q in trees[j].points().iter().step_by(3) {
                let p = pose * nalgebra::Point3::from(q.map(f64::from));
                let query = [p.x as f32, p.y as f32, p.z as f32];
                let Some((n, _)) = trees[i].nearest(query, 0.09) else { continue };
                let centre = trees[i].points()[n as usize];
                trees[i].nearest_many(centre, 0.36, &mut near);
                if near.found().len() < 20 {
                    continue;
                }
                let pts: Vec<_> = near.found().iter().map(|(_, k)| nalgebra::Vector3::from(trees[i].points()[*k as usize].map(f64::from))).collect();
                let c = pts.iter().sum::<nalgebra::Vector3<f64>>() / 20.0;
                let m = pts.iter().map(|p| (p - c) * (p - c).transpose()).sum::<nalgebra::Matrix3<f64>>() / 20.0;
                let e = m.symmetric_eigen();
                let mut order = [0, 1, 2];
                order.sort_by(|a, b| e.eigenvalues[*a].total_cmp(&e.eigenvalues[*b]));
                if e.eigenvalues[order[0]] > 4e-4 || e.eigenvalues[order[1]] < 20.0 * e.eigenvalues[order[0]] {
                    continue;
                }
                let r = e.eigenvectors.column(order[0]).dot(&(p.coords - c));
                count += 1.0;
                good += f64::from(u8::from(r.abs() < 0.02));
                gradient[w] += r.abs().min(0.1);
            }
            shares[w] = good / count;
            gradient[w] /= count;
        }
        wins += usize::from(shares[1] > shares[0]);
        total += 1;
        sum[0] += shares[0];
        sum[1] += shares[1];
        println!("{i:2} {j:2} off {:6.3?} m: share within 2 cm: truth {:.3} registered {:.3}; mean cut-off residual {:.4} {:.4}; overlap {:.2}", &off.as_slice()[..3], shares[0], shares[1], gradient[0], gradient[1], a.overlap);
    }
    println!("registered better in {wins} of {total}: {sum:?}");
}

#[test]
#[ignore]
fn relaxed() {
    let (scans, odometry, truth) = load();
    let mut config = RegistrationConfig { threads: 2, ..RegistrationConfig::default() };
    config.preparation.voxel_m = env("VOXEL", 0.25);
    let mut registration = Registry::default().create("point_to_plane", &config).unwrap();
    let begin = Instant::now();
    let prepared: Vec<_> = scans.iter().map(|s| registration.prepare(ScanView::unordered(s)).unwrap()).collect();
    println!("prepare {:?}", begin.elapsed());
    let mut poses = vec![odometry[0]];
    for k in 1..45 {
        let start = odometry[k - 1].inverse() * odometry[k];
        let a = registration.align(&*prepared[k - 1], &*prepared[k], &start, &Limits::default()).unwrap();
        poses.push(poses[k - 1] * a.target_from_source);
    }
    let reference = read_tum(std::path::Path::new("/tmp/ref_poses_0.15.tum"));
    println!("chain {:?} at {:?}; from reference 2 {:?}", trajectory_error(&poses, &truth).unwrap(), begin.elapsed(), trajectory_error(&poses, &reference));
    let clouds: Vec<&PreparedCloud> = prepared.iter().map(|p| p.as_any().downcast_ref().unwrap()).collect();
    for (stride, distance, first, last, scale) in [(1, 8.0, 1.0, 0.5, 0.1), (4, 8.0, 1.0, 0.5, 0.1), (8, 8.0, 1.0, 0.5, 0.1), (4, 8.0, 0.5, 0.5, 0.1), (4, 5.0, 0.5, 0.5, 0.1), (4, 12.0, 1.0, 0.5, 0.1), (4, 8.0, 1.0, 0.25, 0.05), (4, 8.0, 0.5, 0.25, 0.03)] {
        let mut relaxed = poses.clone();
        let t = Instant::now();
        let c = relaxation::RelaxationConfig { stride, max_distance_m: distance, first_pair_distance_m: first, final_pair_distance_m: last, robust_scale_m: scale, threads: 2, ..Default::default() };
        let r = relaxation::relax(&clouds, &mut relaxed, &c).unwrap();
        println!("stride {stride} {distance} m {first} {last} {scale}: {r:?} in {:?}", t.elapsed());
        let (a, b) = (trajectory_error(&relaxed, &truth).unwrap(), trajectory_error(&relaxed, &reference).unwrap());
        println!("   error {:.4} m {:.3} deg; best fit {:.4?}; from independent graph {:.4} m {:.3} deg", a.ate_rmse_m, a.ate_rmse_deg, rmse_by_best_fit(&relaxed, &truth), b.ate_rmse_m, b.ate_rmse_deg);
    }
}
