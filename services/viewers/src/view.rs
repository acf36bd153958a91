//! From the messages of a run to what viewers are shown, at the right moment and within its share.

use std::any::Any;
use std::collections::{BTreeMap, BTreeSet};

use foxglove::messages::log::Level;
use mirador_core::geometry::Pose;
use mirador_ipc_schema::Header;
use mirador_ipc_schema::messages::{
    AlignmentMeta, MapMeta, Meta, NavigationStatus, Point, PointScore, SERVICE_FAILED, ServiceHealth, ViewPlanMeta,
};
use mirador_ipc_schema::text;
use mirador_ipc_schema::topics::{self, Topic};

use crate::Sink;
use crate::channels::{
    CANDIDATES, CHANNELS, CLOUD, DOTS_CANDIDATES, DOTS_MAP, DOTS_PATH, DOTS_POSES, DOTS_ZONES, GRID, LOG, MODEL, PATH,
    POSES, TF, ZONES,
};
use crate::state::State;

/// Scans that may wait for pose and scores: one whose scores never come must not stay for ever.
const MOST_WAITING: usize = 4;
/// Bytes that a channel may take for every scan whatever the scan's own size.
const LEAST_SHARE: f64 = 32_768.0;
/// Channels that are drawn at every change: each is as large as what is new.
const UNLIMITED: [&str; 3] = [TF, CLOUD, LOG];
/// `NavigationStatus.state`: blocked, recovering, gave up.
const IN_TROUBLE: [u32; 3] = [3, 4, 5];

/// How much is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewConfig {
    /// Most points of a scan.
    pub most_points: usize,
    /// Each channel that shows all there is (model, map, poses, ...) takes at most this share of the bytes that it is
    /// made from, and so is drawn less often the larger it is; `None` draws it at every change.
    pub share: Option<f64>,
    /// Added to the time at which a message was sent [ns]: 0 keeps CLOCK_MONOTONIC, as recordings have it.
    pub clock_offset_ns: u64,
}

/// The topics that something is drawn of.
pub const TOPICS: [&str; 11] = [
    "scan",
    "alignment",
    "pose_corrections",
    "scored_scan",
    "zones",
    "information_map",
    "view_plan",
    "path",
    "robot_pose",
    "navigation_status",
    "service_health",
];

/// A thinned scan that waits for its pose and its scores.
#[derive(Default)]
struct Thinned {
    /// Index in the scan, and position in the scanner's frame.
    points: Vec<(usize, [f32; 3])>,
    quality: Option<Vec<Option<f32>>>,
    map_from_scanner: Option<Pose>,
}

/// Builds what viewers are shown from the messages of a run.
pub struct View {
    config: ViewConfig,
    waiting: BTreeMap<u32, Thinned>,
    state: State,
    /// Channels whose content has changed since they were drawn.
    changed: BTreeSet<&'static str>,
    /// The scan whose plan is being worked on.
    plan_due: Option<u32>,
    /// How many bytes a limited channel may have drawn by now, and how many each has.
    allowance: f64,
    drawn: BTreeMap<&'static str, f64>,
}

impl View {
    /// A view of a run that begins.
    #[must_use]
    pub fn new(config: ViewConfig) -> Self {
        Self {
            config,
            waiting: BTreeMap::new(),
            state: State::new(),
            changed: BTreeSet::new(),
            plan_due: None,
            allowance: 0.0,
            drawn: BTreeMap::new(),
        }
    }

    /// Takes in a message, and draws what has changed unless a plan is being worked on.
    ///
    /// # Errors
    /// What the sink fails of.
    pub fn take<T: Topic, S: Sink>(&mut self, out: &mut S, meta: &T::Meta, items: &[T::Item]) -> Result<(), S::Error> {
        let (topic, header) = (T::RULES.name, *meta.header());
        if topic == topics::Scan::RULES.name && self.plan_due.is_some() {
            // The one before gets no plan.
            self.draw_changed(out, false)?;
        }
        self.enter::<T>(meta, items);
        self.allowance += (size_of::<T::Meta>() + size_of_val(items)) as f64 * self.config.share.unwrap_or(0.0);
        if topic == topics::Scan::RULES.name {
            self.plan_due = Some(header.scan());
            self.allowance += LEAST_SHARE;
        }
        if topic == topics::ViewPlan::RULES.name && self.plan_due.is_some_and(|due| due <= header.scan()) {
            self.plan_due = None;
        }
        if self.plan_due.is_none() { self.draw_changed(out, false) } else { Ok(()) }
    }

    /// Draws what has changed, for the time being nothing more comes.
    ///
    /// # Errors
    /// What the sink fails of.
    pub fn settle<S: Sink>(&mut self, out: &mut S) -> Result<(), S::Error> {
        self.plan_due = None;
        self.draw_changed(out, false)
    }

    /// Draws what has changed, nothing more comes: also what is beyond its share.
    ///
    /// # Errors
    /// What the sink fails of.
    pub fn finish<S: Sink>(&mut self, out: &mut S) -> Result<(), S::Error> {
        self.draw_changed(out, true)
    }

    /// Draws a channel as it is now, for somebody who comes late.
    ///
    /// # Errors
    /// What the sink fails of.
    pub fn present<S: Sink>(&mut self, out: &mut S, channel: &str) -> Result<(), S::Error> {
        match CHANNELS.iter().find(|known| known.topic == channel) {
            Some(known) if known.topic == LOG => self.state.say_again(out),
            Some(known) => self.state.draw(out, known.topic).map(drop),
            None => Ok(()),
        }
    }

    /// Takes in a raw record that an earlier incarnation wrote, so that the view goes on where it was. `data` is the meta
    /// part and then the items, as `run.mcap` has them; what is no message of that topic is passed over.
    pub fn restore(&mut self, topic: &str, data: &[u8]) {
        macro_rules! restore {
            ($kind:ty) => {
                if topic == <$kind as Topic>::RULES.name
                    && let Some((meta, items)) = unpack::<$kind>(data)
                {
                    self.enter::<$kind>(&meta, &items);
                }
            };
        }
        mirador_ipc_schema::for_each_topic!(restore);
        // It was drawn then.
        self.changed.clear();
        self.state.lines_drawn();
    }

    /// Takes in a message without drawing.
    fn enter<T: Topic>(&mut self, meta: &T::Meta, items: &[T::Item]) {
        let mut meta = *meta;
        let header = meta.header_mut();
        header.sent_ns = header.sent_ns.saturating_add(self.config.clock_offset_ns);
        let (header, any): (_, &dyn Any) = (*header, &meta);
        match T::RULES.name {
            "scan" => self.scan(&header, cast(items)),
            "alignment" => any.downcast_ref().into_iter().for_each(|meta| self.alignment(meta)),
            "pose_corrections" => {
                if self.state.correct(&header, cast(items)) {
                    self.change(&[CLOUD]);
                }
                self.change(&[POSES, DOTS_POSES, TF, MODEL]);
            }
            "scored_scan" => self.scores(&header, cast(items)),
            "zones" => {
                self.state.set_zones(&header, cast(items));
                self.change(&[ZONES, DOTS_ZONES]);
            }
            "view_plan" => {
                if let Some(plan) = any.downcast_ref::<ViewPlanMeta>() {
                    self.state.set_plan(plan, cast(items));
                    self.change(&[CANDIDATES, DOTS_CANDIDATES, LOG]);
                }
            }
            "path" => {
                self.state.set_path(&header, cast(items));
                self.change(&[PATH, DOTS_PATH]);
            }
            "information_map" => {
                let has_changed =
                    any.downcast_ref::<MapMeta>().is_some_and(|meta| self.state.tiles.keep(meta, cast(items)));
                if has_changed {
                    self.change(&[GRID, DOTS_MAP]);
                }
            }
            "robot_pose" => {
                let poses = cast(items);
                if poses.last().is_some_and(|pose| self.state.move_robot(&header, pose)) {
                    self.change(&[TF]);
                }
            }
            "service_health" => {
                for health in cast::<ServiceHealth>(items).iter().filter(|h| h.state == SERVICE_FAILED) {
                    let (name, why) = (text::unpack(&health.service), text::unpack(&health.message));
                    self.say(&header, Level::Error, name, why.to_owned());
                }
            }
            "navigation_status" => {
                for status in cast::<NavigationStatus>(items).iter().filter(|s| IN_TROUBLE.contains(&s.state)) {
                    self.say(&header, Level::Warning, "navigation", text::unpack(&status.reason).to_owned());
                }
            }
            _ => {}
        }
    }

    /// Keeps a thinned copy of a scan.
    fn scan(&mut self, header: &Header, points: &[Point]) {
        let step = points.len().div_ceil(self.config.most_points).max(1);
        let kept = points.iter().enumerate().step_by(step).filter(|(_, p)| p.x.is_finite());
        let points = kept.map(|(i, p)| (i, [p.x, p.y, p.z])).collect();
        self.waiting.insert(header.scan(), Thinned { points, ..Thinned::default() });
        while self.waiting.len() > MOST_WAITING {
            self.waiting.pop_first();
        }
    }

    fn alignment(&mut self, meta: &AlignmentMeta) {
        let scan = meta.header.scan();
        match self.state.place_scan(meta) {
            None => {
                self.waiting.remove(&scan);
                self.change(&[LOG]);
            }
            Some(pose) => {
                if let Some(thinned) = self.waiting.get_mut(&scan) {
                    thinned.map_from_scanner = Some(pose);
                }
                self.change(&[TF, POSES, DOTS_POSES]);
                self.show_if_whole(&meta.header);
            }
        }
    }

    fn scores(&mut self, header: &Header, scores: &[PointScore]) {
        if let Some(thinned) = self.waiting.get_mut(&header.scan()) {
            let is_scored = |s: &&PointScore| s.flags & 1 != 0;
            let quality = |i: usize| scores.get(i).filter(is_scored).map(|s| f32::from(s.quality) / 65535.0);
            thinned.quality = Some(thinned.points.iter().map(|(i, _)| quality(*i)).collect());
        }
        self.show_if_whole(header);
    }

    /// Shows a scan as soon as it has both pose and quality.
    fn show_if_whole(&mut self, header: &Header) {
        let scan = header.scan();
        let is_whole = self.waiting.get(&scan).is_some_and(|t| t.quality.is_some() && t.map_from_scanner.is_some());
        if !is_whole {
            return;
        }
        if let Some(Thinned { points, quality: Some(quality), map_from_scanner: Some(pose) }) =
            self.waiting.remove(&scan)
        {
            let points = points.into_iter().zip(quality).map(|((_, position), quality)| (position, quality));
            self.state.show_scan(header, pose, points.collect());
            self.change(&[CLOUD, MODEL]);
        }
    }

    fn say(&mut self, header: &Header, level: Level, name: &str, message: String) {
        self.state.say(header, level, name, message);
        self.change(&[LOG]);
    }

    fn change(&mut self, channels: &[&'static str]) {
        self.changed.extend(channels);
    }

    fn draw_changed<S: Sink>(&mut self, out: &mut S, is_last: bool) -> Result<(), S::Error> {
        for channel in CHANNELS.iter().map(|known| known.topic) {
            if !self.changed.contains(channel) || !(is_last || self.may_draw(channel)) {
                continue;
            }
            self.changed.remove(channel);
            if out.wants(channel) {
                let size = self.state.draw(out, channel)?;
                *self.drawn.entry(channel).or_default() += size as f64;
            }
            if channel == LOG {
                self.state.lines_drawn();
            }
        }
        Ok(())
    }

    /// Whether the channel is still within its share. The first drawing of each is.
    fn may_draw(&self, channel: &'static str) -> bool {
        let drawn = self.drawn.get(channel).copied().unwrap_or(0.0);
        self.config.share.is_none() || UNLIMITED.contains(&channel) || drawn <= self.allowance
    }
}

/// The items as what they are: the name of their topic has told it.
fn cast<I: bytemuck::Pod>(items: &[impl bytemuck::Pod]) -> &[I] {
    bytemuck::try_cast_slice(items).unwrap_or_default()
}

/// Meta part and items of a raw record; `None` when it is not of that topic.
fn unpack<T: Topic>(data: &[u8]) -> Option<(T::Meta, Vec<T::Item>)> {
    let (front, rest) = data.split_at_checked(size_of::<T::Meta>())?;
    let items = rest.chunks_exact(size_of::<T::Item>());
    if !items.remainder().is_empty() {
        return None;
    }
    Some((bytemuck::pod_read_unaligned(front), items.map(bytemuck::pod_read_unaligned).collect()))
}

#[cfg(test)]
#[path = "view_tests.rs"]
mod tests;
