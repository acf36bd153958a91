//! The odometry: predict, reduce, deskew, align, judge, learn, add to the map.

use super::deskew;
use super::local_map::LocalMap;
use super::reduce::{Centroid, Reducer, Reduction};
use super::registration::{Frame, Outcome, Resolution, Schedule};
use super::search::Search;
use super::threshold::AdaptiveThreshold;
use super::track::{Prediction, Track};
use super::{FrameRecord, FrameStatus, FrameTime, OdometryConfig, Start};
use crate::geometry::{Covariance, Pose, Twist};
use crate::registration::ConfigError;
use crate::scan::ScanView;

/// Cells of the reduction a voxel's edge.
const CELLS_A_VOXEL: f64 = 4.0;
/// Edge of the cells of which one point each is aligned, in voxels.
const SPACING_VOXELS: f64 = 0.75;
/// A score this much below the usual one is no proof of a pose.
const USUAL_SHARE: f64 = 0.85;
/// The same while the motion model is off by more than a voxel, so that wrong poses are at hand.
const USUAL_SHARE_WITHOUT_MODEL: f64 = 0.97;
/// The second frame fits the map as well as this share of the first, which made it.
const FIRST_SHARE: f64 = 0.6;
/// The usual score fades by this factor with every frame that is lost: the scene may have changed.
const FADING: f64 = 0.9;
/// The search reaches farther with every frame that was lost, up to so many radii.
const MOST_RADII: f64 = 3.0;
/// How fast the usual score follows.
const LEARNING: f64 = 0.1;
/// A frame is deskewed and aligned again when the found motion carries a far point this much elsewhere than the
/// predicted one [m].
const DESKEW_TOLERANCE_M: f64 = 0.02;
/// Times a frame is deskewed at most.
const MOST_DESKEWS: u32 = 3;

/// Scan-to-local-map odometry for spinning and hand-held scanners.
///
/// One call a frame. Results depend on the frames alone, not on the number of threads. Once its buffers are warm a
/// frame that needs no search allocates nothing, apart from what starting a second thread takes.
#[derive(Debug)]
pub struct Odometry {
    pub(super) config: OdometryConfig,
    pub(super) map: LocalMap,
    pub(super) threshold: AdaptiveThreshold,
    pub(super) track: Track,
    /// What frames here usually score.
    pub(super) usual_score: f64,
    pub(super) reducer: Reducer,
    pub(super) centroids: Vec<Centroid>,
    pub(super) selected: Vec<u32>,
    pub(super) frame: Frame,
    /// A part of the frame, for alignments in coarse voxels.
    pub(super) thinned: Frame,
    pub(super) search: Search,
    pub(super) deskewed: Vec<[f32; 3]>,
    /// The first frame's centroids while its motion is unknown: it is deskewed when the second has told it.
    pub(super) first: Vec<Centroid>,
}

/// An alignment and where it began.
type Candidate = (Start, Outcome);

impl Odometry {
    /// An odometry with an empty map. Allocates the map.
    ///
    /// # Errors
    /// The first setting out of range.
    pub fn new(config: OdometryConfig) -> Result<Self, ConfigError> {
        config.validate()?;
        Ok(Self {
            map: LocalMap::new(config.voxel_m, config.max_range_m, config.max_voxels),
            threshold: AdaptiveThreshold::new(config.initial_threshold_m, config.min_motion_m, config.max_range_m),
            track: Track::default(),
            usual_score: 0.0,
            reducer: Reducer::default(),
            centroids: Vec::new(),
            selected: Vec::new(),
            frame: Frame::default(),
            thinned: Frame::default(),
            search: Search::default(),
            deskewed: Vec::new(),
            first: Vec::new(),
            config,
        })
    }

    /// The settings.
    #[must_use]
    pub fn config(&self) -> &OdometryConfig {
        &self.config
    }

    /// Forgets map and motion; keeps the memory.
    pub fn reset(&mut self) {
        self.map.clear();
        self.threshold.reset();
        self.track = Track::default();
        self.usual_score = 0.0;
        self.first.clear();
    }

    /// Begins anew with a map of what others know of the surroundings: reduced points [m] with their poses
    /// `map_from_scanner`. The scanner stands at `map_from_scanner`; nothing is known of its motion.
    pub fn restart<'p>(
        &mut self,
        map_from_scanner: &Pose,
        known: impl IntoIterator<Item = (&'p Pose, &'p [[f32; 3]])>,
    ) {
        self.reset();
        self.map.recentre(map_from_scanner);
        for (map_from_points, points) in known {
            self.map.insert(points, map_from_points, self.config.threads);
        }
        self.track.restart(map_from_scanner);
    }

    /// The memory it holds [bytes]. The map's part, nearly all of it, is the same from the first frame on.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.map.bytes()
            + self.reducer.bytes()
            + self.frame.bytes()
            + self.thinned.bytes()
            + self.search.bytes()
            + (self.centroids.capacity() + self.first.capacity()) * size_of::<Centroid>()
            + self.selected.capacity() * size_of::<u32>()
            + self.deskewed.capacity() * size_of::<[f32; 3]>()
    }

    /// One point a voxel of the local map: the mean of what was seen there [m, map frame].
    pub fn map_points(&self) -> impl Iterator<Item = nalgebra::Point3<f64>> {
        self.map.points()
    }

    /// The reduced points of the last frame, deskewed [m, scanner frame at the end of the scan]; of one that was not
    /// tracked, whatever it was compared with the map by.
    #[must_use]
    pub fn frame_points(&self) -> &[[f32; 3]] {
        &self.deskewed
    }

    /// Where the scanner was at the end of this scan.
    ///
    /// `time` tells when the frame was taken; without it frames are taken as evenly spaced, each lasting until the
    /// next. `guess` is `map_from_scanner` at the end of the scan from another source; without it the last motion is
    /// thought to go on.
    pub fn register_frame(&mut self, scan: ScanView<'_>, time: Option<FrameTime>, guess: Option<Pose>) -> FrameRecord {
        self.register(scan, time, guess, self.config.search_radius_m)
    }

    /// As [`Self::register_frame`], but without the search: for who knows a surer way to find a scanner that is lost.
    pub fn register_frame_nearby(
        &mut self,
        scan: ScanView<'_>,
        time: Option<FrameTime>,
        guess: Option<Pose>,
    ) -> FrameRecord {
        self.register(scan, time, guess, 0.0)
    }

    fn register(
        &mut self,
        scan: ScanView<'_>,
        time: Option<FrameTime>,
        guess: Option<Pose>,
        search_radius_m: f64,
    ) -> FrameRecord {
        let prediction = self.track.predict(time, guess);
        if !prediction.is_usable() {
            self.track.skip();
            return self.unaligned(FrameStatus::InvalidGuess, &prediction);
        }
        self.reduce(scan);
        if self.selected.len() < self.config.minimum_points {
            self.track.skip();
            return self.unaligned(FrameStatus::TooFewPoints, &prediction);
        }
        if self.map.is_empty() {
            return self.begin(&prediction);
        }
        if prediction.is_stale {
            self.threshold.reset();
        }
        self.map.recentre(&prediction.pose);
        let (candidate, searched) = self.find(&prediction, search_radius_m);
        let (start, outcome) = self.refine_motion(candidate, &prediction);
        self.conclude(start, &outcome, searched, &prediction)
    }

    /// Centroids of the scan, and which of them are aligned.
    fn reduce(&mut self, scan: ScanView<'_>) {
        let settings = Reduction {
            min_range_m: self.config.min_range_m as f32,
            max_range_m: self.config.max_range_m as f32,
            cell_m: (self.config.voxel_m / CELLS_A_VOXEL) as f32,
        };
        self.reducer.centroids(scan, &settings, &mut self.centroids);
        let spacing = (self.config.voxel_m * SPACING_VOXELS) as f32;
        self.reducer.select(&self.centroids, spacing, &mut self.selected);
    }

    /// The map begins with this frame.
    fn begin(&mut self, prediction: &Prediction) -> FrameRecord {
        self.map.recentre(&prediction.pose);
        self.deskew_selected(&Twist::zeros());
        self.deskew_all(&Twist::zeros());
        self.map.insert(&self.deskewed, &prediction.pose, self.config.threads);
        let scale = self.config.robust_scale_m as f32;
        self.usual_score = FIRST_SHARE * self.frame.score(&self.map, &prediction.pose, scale);
        self.first.clone_from(&self.centroids);
        self.track.begin(prediction);
        FrameRecord {
            covariance: Covariance::identity() * 1e-12,
            score: 1.0,
            overlap: 1.0,
            converged: true,
            ..self.unaligned(FrameStatus::Started, prediction)
        }
    }

    /// The best alignment from the prediction, from standing still, or from the search.
    fn find(&mut self, prediction: &Prediction, search_radius_m: f64) -> (Candidate, u32) {
        self.deskew_selected(&prediction.scan_motion);
        let wanted = self.wanted_score();
        let mut best = (prediction.start, self.align(&prediction.pose));
        if best.1.score < wanted {
            let still = (Start::ZeroMotion, self.align(&prediction.last));
            best = better(best, still);
        }
        if best.1.score >= wanted || search_radius_m <= 0.0 {
            return (best, 0);
        }
        let schedule = self.schedule(Resolution::Coarse);
        let radius = search_radius_m * prediction.intervals().min(MOST_RADII);
        let found = self.search.run(&self.map, &self.frame, &prediction.last, radius, &schedule, &self.config);
        for pose in found.best.into_iter().flatten() {
            best = better(best, (Start::Search, self.align(&pose)));
        }
        (best, found.tried)
    }

    /// Aligns the frame from a start: in coarse voxels first when the start may be far off.
    fn align(&mut self, start: &Pose) -> Outcome {
        let mut pose = *start;
        let mut coarse_iterations = 0;
        if self.threshold.sigma_m() > 0.5 * self.config.voxel_m {
            let schedule = self.schedule(Resolution::Coarse);
            let coarse = self.thinned.align(&self.map, &pose, &schedule, &self.config);
            pose = coarse.map_from_scanner;
            coarse_iterations = coarse.iterations;
        }
        let schedule = self.schedule(Resolution::Fine);
        let mut outcome = self.frame.align(&self.map, &pose, &schedule, &self.config);
        outcome.iterations += coarse_iterations;
        outcome
    }

    fn schedule(&self, resolution: Resolution) -> Schedule {
        let (voxel, last) = (self.config.voxel_m as f32, self.config.robust_scale_m as f32);
        let sigma = self.threshold.sigma_m() as f32;
        match resolution {
            Resolution::Coarse => Schedule {
                resolution,
                first_scale_m: sigma.clamp(last, 2.0 * voxel),
                last_scale_m: (0.5 * voxel).max(last),
                most_iterations: self.config.max_iterations,
            },
            Resolution::Fine => Schedule {
                resolution,
                first_scale_m: sigma.clamp(last, 0.5 * voxel.max(2.0 * last)),
                last_scale_m: last,
                most_iterations: self.config.max_iterations,
            },
        }
    }

    /// The score below which a pose is not believed without a search.
    fn wanted_score(&self) -> f64 {
        let model_is_off = self.threshold.sigma_m() > self.config.voxel_m && !self.track.is_beginning();
        let share = if model_is_off { USUAL_SHARE_WITHOUT_MODEL } else { USUAL_SHARE };
        (share * self.usual_score).max(self.config.minimum_score)
    }

    /// Deskews by the motion that was found, and aligns again, until both agree.
    fn refine_motion(&mut self, candidate: Candidate, prediction: &Prediction) -> Candidate {
        let (start, mut outcome) = candidate;
        let mut used = prediction.scan_motion;
        if !self.has_times() {
            return (start, outcome);
        }
        let range = outcome.constraint.length_m;
        // The second frame sets the first right as well, which changes the map, which takes more rounds.
        let rounds = if self.first.is_empty() { MOST_DESKEWS } else { 3 * MOST_DESKEWS };
        for _ in 1..rounds {
            let found = prediction.scan_motion_to(&outcome.map_from_scanner);
            if outcome.score < self.least_score() || deskew::difference_m(&used, &found, range) < DESKEW_TOLERANCE_M {
                break;
            }
            self.deskew_first(&found);
            self.deskew_selected(&found);
            used = found;
            let schedule = self.schedule(Resolution::Fine);
            let again = self.frame.align(&self.map, &outcome.map_from_scanner, &schedule, &self.config);
            outcome = Outcome { iterations: outcome.iterations + again.iterations, ..again };
        }
        (start, outcome)
    }

    /// Judges the alignment, learns from it, and adds the frame to the map.
    fn conclude(&mut self, start: Start, outcome: &Outcome, searched: u32, prediction: &Prediction) -> FrameRecord {
        let record = self.record(start, outcome, searched, prediction);
        if !record.status.is_tracked() {
            self.usual_score *= FADING;
            self.track.skip();
            return FrameRecord { map_from_scanner: prediction.pose, ..record };
        }
        let found = outcome.map_from_scanner;
        self.threshold.update(&(prediction.pose.inverse() * found));
        let learning = if self.track.is_beginning() { 1.0 } else { LEARNING };
        self.usual_score += learning * (record.score - self.usual_score);
        let motion = prediction.scan_motion_to(&found);
        self.first.clear();
        self.deskew_all(&motion);
        self.map.insert(&self.deskewed, &found, self.config.threads);
        self.track.advance(prediction, &found);
        let scan_motion = if self.has_times() { motion } else { Twist::zeros() };
        FrameRecord { scan_motion, ..record }
    }
}

fn better(one: Candidate, other: Candidate) -> Candidate {
    if other.1.score > one.1.score { other } else { one }
}
