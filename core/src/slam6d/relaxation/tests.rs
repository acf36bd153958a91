//! Relaxation of simulated and real scans.
