//! The odometry on real and simulated scans.

mod bad_input;
mod moving_scanner;
mod real_data;
mod synthetic;
