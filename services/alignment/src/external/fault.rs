//! What can be wrong with an answer, or with there being none.

use mirador_ipc_schema::messages as m;
use thiserror::Error;

/// Why the built-in method took the place of the foreign one.
#[derive(Debug, Clone, PartialEq, Error)]
pub(crate) enum Fault {
    #[error("no registration process answers")]
    Absent,
    #[error("the registration process ended while it was asked")]
    Died,
    #[error("no answer within {deadline_ms} ms")]
    Late { deadline_ms: u32 },
    #[error("it answered request {answered} instead of request {asked}, and nothing within {deadline_ms} ms")]
    Outdated { answered: u64, asked: u64, deadline_ms: u32 },
    #[error("its {what} holds a value that is not finite")]
    NotFinite { what: &'static str },
    #[error("its pose is not a rigid motion")]
    NotRigid,
    #[error("its covariance is not symmetric and positive definite")]
    Covariance,
    #[error(
        "its pose is {metres:.3} m and {radians:.3} rad from the start; {max_metres:.3} m and {max_radians:.3} rad are allowed"
    )]
    Outside { metres: f64, radians: f64, max_metres: f64, max_radians: f64 },
    #[error("its pose fits worse than the start it was given (cost {cost:.2e} m^2, {start_cost:.2e} m^2 at the start)")]
    WorseThanStart { cost: f64, start_cost: f64 },
    #[error(
        "its pose is not the end: {steps} steps of {fallback} from there bring the cost from {cost:.2e} to {after:.2e} m^2"
    )]
    Unsettled { cost: f64, after: f64, steps: u32, fallback: String },
    #[error("its pose is not believed ({why}), and {fallback} found one that is")]
    Missed { why: String, fallback: String },
    #[error("it floods: {results} results since the last request")]
    Flood { results: u64 },
    #[error("it was built with another schema of the messages: here {here:08x}, there {there:08x}")]
    Schema { here: u32, there: u32 },
    #[error("the request could not be sent: {reason}")]
    NotSent { reason: String },
    #[error("it failed {failures} times in a row and is not asked for the next {left} requests")]
    Paused { failures: u32, left: u32 },
}

impl Fault {
    /// Its place among the counters of [`m::RegistrationStatus`].
    pub fn place(&self) -> usize {
        match self {
            Self::Absent => m::REGISTRATION_ABSENT,
            Self::Died => m::REGISTRATION_DIED,
            Self::Late { .. } => m::REGISTRATION_LATE,
            Self::Outdated { .. } => m::REGISTRATION_OUTDATED,
            Self::NotFinite { .. } => m::REGISTRATION_NOT_FINITE,
            Self::NotRigid => m::REGISTRATION_NOT_RIGID,
            Self::Covariance => m::REGISTRATION_COVARIANCE,
            Self::Outside { .. } => m::REGISTRATION_OUTSIDE,
            Self::WorseThanStart { .. } | Self::Unsettled { .. } | Self::Missed { .. } => m::REGISTRATION_WRONG,
            Self::Flood { .. } => m::REGISTRATION_FLOOD,
            Self::Schema { .. } => m::REGISTRATION_SCHEMA,
            Self::NotSent { .. } => m::REGISTRATION_NOT_SENT,
            Self::Paused { .. } => m::REGISTRATION_PAUSED,
        }
    }

    /// Whether the process is at fault, so that it is asked less often when it goes on like this.
    pub fn is_its_own(&self) -> bool {
        !matches!(self, Self::Absent | Self::NotSent { .. } | Self::Paused { .. })
    }
}

/// The names of the counters of [`m::RegistrationStatus`], in their order.
pub const FAULT_WORDS: [&str; 13] = [
    "absent",
    "died",
    "late",
    "outdated",
    "not_finite",
    "not_rigid",
    "covariance",
    "outside",
    "wrong",
    "flood",
    "schema",
    "not_sent",
    "paused",
];
