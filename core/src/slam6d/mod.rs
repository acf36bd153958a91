//! slam6d
