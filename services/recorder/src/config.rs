//! Configuration of the recorder.

use mirador_ipc_schema::topics;
use mirador_viewers::ViewConfig;
use serde::{Deserialize, Serialize};

/// How chunks of the recording are compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Compression {
    /// Not at all: measured noise hardly compresses, and this is the fastest.
    #[default]
    None,
    /// LZ4: about a tenth smaller, a quarter of the speed.
    Lz4,
}

/// What the recorder writes, and how.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecorderConfig {
    /// Compression of the chunks.
    pub compression: Compression,
    /// A chunk is closed when it is larger than this [bytes].
    pub chunk_bytes: u64,
    /// Write the view for Foxglove and Rerun beside the raw records.
    pub foxglove: bool,
    /// Most points of a scan in that view; the raw records always hold all of them.
    pub foxglove_points: usize,
    /// A scan is acknowledged when it was written on each of these topics: `scan`, `alignment`, `loop_closing`,
    /// `scored_scan`, `view_plan`. A graph without planning leaves out `view_plan`, one with an alignment of its own
    /// `loop_closing`.
    pub acknowledge_after: Vec<String>,
    /// Topics that are not recorded: what sensors say many times a second need not be kept where their scans are.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub leave_out: Vec<String>,
}

impl Default for RecorderConfig {
    fn default() -> Self {
        Self {
            compression: Compression::None,
            chunk_bytes: 4 << 20,
            foxglove: true,
            foxglove_points: 100_000,
            acknowledge_after: ACKNOWLEDGED.iter().map(|t| (*t).to_owned()).collect(),
            leave_out: Vec::new(),
        }
    }
}

/// Share of the raw records that each channel of the view which shows all there is (model, map, poses, ...) may take.
const VIEW_SHARE: f64 = 0.02;

/// The topics that have one message a scan.
const ACKNOWLEDGED: [&str; 5] = ["scan", "alignment", "loop_closing", "scored_scan", "view_plan"];

/// What is wrong with a [`RecorderConfig`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ConfigError {
    /// A number lies outside its range.
    #[error("recorder.{field} = {value} is outside {least} to {most}")]
    Range {
        /// Name of the field.
        field: &'static str,
        /// Its value.
        value: u64,
        /// Smallest value.
        least: u64,
        /// Largest value.
        most: u64,
    },
    /// `acknowledge_after` names a topic that does not have one message a scan, or is empty.
    #[error(
        "recorder.acknowledge_after = {value:?}: name at least one of scan, alignment, loop_closing, scored_scan, view_plan"
    )]
    Acknowledge {
        /// Its value.
        value: Vec<String>,
    },
    /// `leave_out` names a topic that does not exist, or one that a run cannot be understood without.
    #[error("recorder.leave_out: {0:?} cannot be left out; only these can: {list}", list = can_be_left_out().join(", "))]
    LeaveOut(
        /// The topic.
        String,
    ),
}

/// What sensors say, and the topics whose readers may miss messages anyway.
fn can_be_left_out() -> Vec<&'static str> {
    let may_miss = |rules: &topics::Rules| rules.lag == topics::Lag::DropOldest || rules.publisher == "simulator";
    topics::ALL.iter().map(|topic| topic.rules).filter(may_miss).map(|rules| rules.name).collect()
}

impl RecorderConfig {
    /// Checks every field.
    ///
    /// # Errors
    /// See [`ConfigError`].
    pub fn validate(&self) -> Result<(), ConfigError> {
        let range = |field, value: u64, least, most| {
            if (least..=most).contains(&value) { Ok(()) } else { Err(ConfigError::Range { field, value, least, most }) }
        };
        range("chunk_bytes", self.chunk_bytes, 1 << 10, 1 << 30)?;
        range("foxglove_points", self.foxglove_points as u64, 1, 100_000_000)?;
        let known = |name: &String| ACKNOWLEDGED.contains(&name.as_str());
        if self.acknowledge_after.is_empty() || !self.acknowledge_after.iter().all(known) {
            return Err(ConfigError::Acknowledge { value: self.acknowledge_after.clone() });
        }
        match self.leave_out.iter().find(|name| !can_be_left_out().contains(&name.as_str())) {
            Some(name) => Err(ConfigError::LeaveOut(name.clone())),
            None => Ok(()),
        }
    }

    /// How much of the view is written.
    pub(crate) fn view(&self) -> ViewConfig {
        ViewConfig { most_points: self.foxglove_points, share: Some(VIEW_SHARE), clock_offset_ns: 0 }
    }

    /// Whether messages on this topic are written down.
    pub(crate) fn records(&self, topic: &str) -> bool {
        self.leave_out.iter().all(|name| name != topic)
    }

    /// The topics of `acknowledge_after` under their static names.
    pub(crate) fn acknowledged(&self) -> Vec<&'static str> {
        topics::ALL
            .iter()
            .map(|t| t.rules.name)
            .filter(|name| self.acknowledge_after.iter().any(|wanted| wanted == name))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_valid_and_survives_toml() {
        let config = RecorderConfig::default();
        config.validate().unwrap();
        let text = toml::to_string(&config).unwrap();
        assert_eq!(toml::from_str::<RecorderConfig>(&text).unwrap(), config);
    }

    #[test]
    fn an_unknown_key_is_refused() {
        assert!(toml::from_str::<RecorderConfig>("chunk = 3").is_err());
    }

    #[test]
    fn a_value_out_of_range_names_its_field() {
        let config = RecorderConfig { chunk_bytes: 1, ..RecorderConfig::default() };
        assert!(config.validate().unwrap_err().to_string().contains("recorder.chunk_bytes = 1"));
        let config = RecorderConfig { acknowledge_after: vec!["zones".into()], ..RecorderConfig::default() };
        assert!(config.validate().unwrap_err().to_string().contains("acknowledge_after"));
        for name in ["scan", "smell"] {
            let config = RecorderConfig { leave_out: vec![name.into()], ..RecorderConfig::default() };
            let error = config.validate().unwrap_err().to_string();
            assert!(error.contains(name) && error.contains("laser_sweep"), "{error}");
        }
    }
}
