//! Life and death of the processes of a graph.

mod child;
mod monitor;
mod process;
mod registration;
mod run;

pub use child::{Launch, Supervised, last_line};
pub use monitor::Monitor;
pub use process::{die_with_parent, exec_child, pin_to};
pub use registration::RegistrationTally;
pub use run::{Ended, RunOutcome, RunPlan, Seat, check_slots, run};
