//! `mirador experiment`: the source's simulated experiments (section 10) and every strategy besides, over several seeds,
//! in the kinematic mode of [`crate::exploration`].
//!
//! Every finished run is a file, so that an interrupted experiment goes on where it was. From the files alone come the
//! rows of `experiment.json`, the tables of `experiment.md` and the page `experiment.html`.

mod curves;
mod entries;
mod error;
mod literature;
mod markdown;
mod matched;
mod page;
mod picture;
mod record;
mod results;
mod rows;
mod runner;
mod settings;
mod store;

pub use entries::{Entry, entries};
pub use error::ExperimentError;
pub use literature::{LITERATURE, Literature};
pub use matched::{Matched, matched};
pub use record::RunRecord;
pub use results::{Group, Results};
pub use runner::{Ending, run};
pub use settings::Settings;

#[cfg(test)]
mod tests;

/// The strategy that the others are compared with.
const OWN: &str = "coverage_tour";
