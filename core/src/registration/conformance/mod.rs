//! What every registration method must do, for methods of this crate and of any other.
//!
//! In the tests of your crate, where `MyMethod` is yours:
//!
//! ```ignore
//! mod conformance {
//!     mirador_core::registration_conformance!(|config| Box::new(MyMethod::new(config)));
//! }
//! ```
//!
//! makes one test of each check. The checks use the default settings unless they say otherwise, draw the same motions in
//! every run, and take a second or two each for a method as fast as the built-in ones.

mod checks;
mod draw;
pub mod scenes;

pub use checks::*;

use super::{Registration, RegistrationConfig};

/// Makes the method under test.
pub type Make<'a> = &'a dyn Fn(&RegistrationConfig) -> Box<dyn Registration>;

/// Makes one test of each check of [`conformance`](crate::registration::conformance). The argument is a closure that
/// makes the method from its settings: `|config: &RegistrationConfig| -> Box<dyn Registration>`.
#[macro_export]
macro_rules! registration_conformance {
    ($make:expr) => {
        $crate::registration_conformance! { $make;
            a_small_motion_is_recovered_from_identity
            target_and_source_may_change_places
            the_result_is_never_worse_than_the_start_nor_outside_the_limits
            a_truth_beyond_d_max_ends_at_the_border_and_says_so
            scans_of_different_places_have_no_overlap
            along_a_corridor_the_start_is_kept_and_said_to_be_unknown
            a_bare_floor_constrains_height_roll_and_pitch_only
            cells_without_a_return_change_nothing
            the_same_bits_come_out_for_any_number_of_threads_and_after_other_work
            the_covariance_is_positive_definite_and_largest_where_the_geometry_is_weakest
            a_scan_with_nothing_to_align_is_refused_by_type
            a_question_that_makes_no_sense_is_refused_by_type
        }
    };
    ($make:expr; $($check:ident)*) => {
        $(
            #[test]
            fn $check() {
                $crate::registration::conformance::$check(&$make);
            }
        )*
    };
}

#[cfg(test)]
mod tests {
    use super::super::Registry;

    macro_rules! built_in {
        ($($method:ident)*) => {
            $(mod $method {
                crate::registration_conformance!(|config| {
                    crate::registration::Registry::default().create(stringify!($method), config).unwrap()
                });
            })*

            #[test]
            fn every_built_in_method_is_checked() {
                assert_eq!(Registry::default().names().collect::<Vec<_>>(), [$(stringify!($method)),*]);
            }
        };
    }
    built_in! { gicp ndt point_to_plane point_to_point symmetric_point_to_plane vgicp }
}
