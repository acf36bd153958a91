//! One consistent map of all scans: loops are closed and older scans corrected (section 3, steps 4 and 5).
//!
//! [`GlobalAligner::align_next`] does what the plan of the newest scan waits for: the sequential pair.
//! [`GlobalAligner::correct`] does the rest, later: it registers the scan with others it overlaps, looks for loops, and
//! moves older scans to where all pairs fit best.

mod aligner;
mod candidates;
mod config;
mod footprint;
mod front_end;
mod journal;
mod keyframe;
mod map;
mod older;
mod pairs;
mod positions;
mod record;
mod relax;
#[cfg(test)]
mod tests;
mod uncertainty;
mod verification;

pub use aligner::{GlobalAligner, Journalled, MapRestoreError};
pub use config::{CorrectionMethod, GlobalConfig};
pub use journal::{CorrectionEntry, JournalEntry, MeasuredPair, ScanEntry};
pub use keyframe::KeyframeError;
pub use record::{
    CorrectionRecord, PairKind, PairRecord, PairRejection, PairStart, PoseCorrection, Relaxation, SwitchedLoop,
};
