//! The one suite for every format.
