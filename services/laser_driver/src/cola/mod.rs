//! CoLa A, the text protocol of SICK's lasers: telegrams between STX and ETX whose words are separated by spaces. After
//! the manufacturer's "Telegram Listing, Ranging sensors LMS1xx, LMS5xx, TiM5xx, ...".

mod framer;
mod scan_data;
mod session;

pub(crate) use framer::{Framer, wrapped};
pub(crate) use scan_data::{ScanData, TelegramError};
pub(crate) use session::{Event, Session, SessionError};
