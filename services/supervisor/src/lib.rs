//! s
pub mod explain;
pub mod outputs;
