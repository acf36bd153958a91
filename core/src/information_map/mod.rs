//! information_map
