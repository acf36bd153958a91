//! Captures of a spinning laser's network packets: `.pcap` and `.pcapng` files with the data packets of a Velodyne VLP-16
//! (Puck, Puck LITE) or HDL-32E. Every revolution is a scan.

mod packets;
mod revolutions;
mod velodyne;

#[cfg(test)]
mod tests;

pub use packets::CaptureError;
pub use revolutions::{Capture, Revolution};
