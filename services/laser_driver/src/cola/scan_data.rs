//! The telegram of one sweep, `LMDscandata`.

/// One sweep as the device says it.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct ScanData {
    /// Counts the sweeps of the device, 16 bits.
    pub scan_counter: u16,
    /// Since the device was switched on, when the sweep was measured [us].
    pub measured_us: u32,
    /// The same clock when it was handed over for sending [us].
    pub sent_us: u32,
    /// Whether the device reports a fault or dirt on its window (status other than 0).
    pub device_status: u16,
    /// Sweeps a second [Hz].
    pub scan_frequency: f64,
    /// Angle of the first beam in the device's own frame [deg]; ahead is 90.
    pub start_angle_deg: f64,
    /// From beam to beam [deg].
    pub angle_step_deg: f64,
    /// Ranges [m]; 0 where there was no return.
    pub ranges: Vec<f32>,
    /// Strengths of the returns in the device's scale; empty when it does not send them.
    pub strengths: Vec<u16>,
}

/// Why a telegram is not a sweep.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(crate) enum TelegramError {
    /// It is not text, or of another kind.
    #[error("the telegram is not scan data: '{0}'")]
    OtherKind(String),
    /// It ends before this field.
    #[error("the scan data end before {0}")]
    Short(&'static str),
    /// A field does not hold what it should.
    #[error("{field} of the scan data is '{word}', which is not {expected}")]
    Field {
        /// Which field.
        field: &'static str,
        /// What it holds.
        word: String,
        /// What it should hold.
        expected: &'static str,
    },
    /// Channels of one sweep do not fit each other.
    #[error("the scan data have {ranges} ranges but {strengths} strengths")]
    Uneven {
        /// Number of ranges.
        ranges: usize,
        /// Number of strengths.
        strengths: usize,
    },
}

/// More beams than any device of the family has.
const MOST_BEAMS: u32 = 20_000;

/// Goes through the words of a telegram. Numbers are hexadecimal, or decimal where they have a sign.
struct Words<'a>(std::str::SplitAsciiWhitespace<'a>);

impl<'a> Words<'a> {
    fn word(&mut self, field: &'static str) -> Result<&'a str, TelegramError> {
        self.0.next().ok_or(TelegramError::Short(field))
    }

    /// An unsigned number of at most 32 bits.
    fn number(&mut self, field: &'static str) -> Result<u32, TelegramError> {
        let word = self.word(field)?;
        let bad = || TelegramError::Field { field, word: shortened(word), expected: "a number" };
        match word.strip_prefix(['+', '-']) {
            Some(decimal) => {
                let value: u32 = decimal.parse().map_err(|_| bad())?;
                Ok(if word.starts_with('-') { value.wrapping_neg() } else { value })
            }
            None => u32::from_str_radix(word, 16).map_err(|_| bad()),
        }
    }

    fn short(&mut self, field: &'static str) -> Result<u16, TelegramError> {
        let value = self.number(field)?;
        u16::try_from(value).map_err(|_| TelegramError::Field {
            field,
            word: format!("{value:X}"),
            expected: "a number of 16 bits",
        })
    }

    /// A number of 32 bits with a sign.
    fn signed(&mut self, field: &'static str) -> Result<i32, TelegramError> {
        Ok(self.number(field)?.cast_signed())
    }

    /// The bits of an f32.
    fn float(&mut self, field: &'static str) -> Result<f32, TelegramError> {
        let bits = self.number(field)?;
        let value = f32::from_bits(bits);
        if value.is_finite() {
            return Ok(value);
        }
        Err(TelegramError::Field { field, word: format!("{bits:X}"), expected: "a finite number" })
    }
}

fn shortened(word: &str) -> String {
    word.chars().take(24).collect()
}

impl ScanData {
    /// Reads a telegram, without its frame.
    ///
    /// # Errors
    /// See [`TelegramError`]; nothing is made up for what is missing.
    pub fn parse(telegram: &[u8]) -> Result<Self, TelegramError> {
        let other = || TelegramError::OtherKind(shortened(&String::from_utf8_lossy(telegram)));
        let text = std::str::from_utf8(telegram).map_err(|_| other())?;
        let mut words = Words(text.split_ascii_whitespace());
        let is_data = matches!(words.0.next(), Some("sSN" | "sRA")) && words.0.next() == Some("LMDscandata");
        if !is_data {
            return Err(other());
        }
        for field in ["the version", "the device number", "the serial number", "the first device status"] {
            words.word(field)?;
        }
        let mut data = Self { device_status: words.short("the device status")?, ..Self::default() };
        words.word("the telegram counter")?;
        data.scan_counter = words.short("the scan counter")?;
        data.measured_us = words.number("the time since start-up")?;
        data.sent_us = words.number("the time of transmission")?;
        for field in
            ["the digital inputs", "the digital inputs", "the digital outputs", "the digital outputs", "the layer"]
        {
            words.word(field)?;
        }
        data.scan_frequency = f64::from(words.number("the scan frequency")?) / 100.0;
        if !(1.0..=1000.0).contains(&data.scan_frequency) {
            let word = format!("{} Hz", data.scan_frequency);
            return Err(TelegramError::Field { field: "the scan frequency", word, expected: "between 1 and 1000 Hz" });
        }
        words.word("the measurement frequency")?;
        for _ in 0..words.number("the number of encoders")?.min(3) {
            words.word("an encoder's position")?;
            words.word("an encoder's speed")?;
        }
        data.read_channels(&mut words, "the number of 16-bit channels")?;
        data.read_channels(&mut words, "the number of 8-bit channels")?;
        if data.ranges.is_empty() {
            return Err(TelegramError::Short("the ranges (DIST1)"));
        }
        if !data.strengths.is_empty() && data.strengths.len() != data.ranges.len() {
            let (ranges, strengths) = (data.ranges.len(), data.strengths.len());
            return Err(TelegramError::Uneven { ranges, strengths });
        }
        Ok(data)
    }

    fn read_channels(&mut self, words: &mut Words<'_>, field: &'static str) -> Result<(), TelegramError> {
        for _ in 0..words.number(field)?.min(16) {
            let content = words.word("the content of a channel")?;
            let (scale, offset) = (words.float("a scale factor")?, words.float("a scale offset")?);
            let start = f64::from(words.signed("a start angle")?) / 10_000.0;
            let step = f64::from(words.number("an angular step")?) / 10_000.0;
            let count = words.number("the number of beams")?;
            if count == 0 || count > MOST_BEAMS || step <= 0.0 || step > 10.0 {
                let word = format!("{count} beams every {step} deg");
                return Err(TelegramError::Field { field: "the fan", word, expected: "a fan of the family" });
            }
            let mut values = (0..count).map(|_| words.short("a beam"));
            match content {
                "DIST1" => {
                    (self.start_angle_deg, self.angle_step_deg) = (start, step);
                    // The device counts millimetres.
                    let metres = |raw: u16| if raw == 0 { 0.0 } else { (f32::from(raw) * scale + offset) / 1000.0 };
                    self.ranges = values.map(|raw| raw.map(metres)).collect::<Result<_, _>>()?;
                }
                "RSSI1" => self.strengths = values.collect::<Result<_, _>>()?,
                // Further returns of a beam, or velocities: not asked for, passed over.
                _ => values.try_for_each(|raw| raw.map(|_| ()))?,
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A telegram as the manufacturer's listing describes it, with a short fan.
    const TELEGRAM: &str = "sSN LMDscandata 1 1 89A27F 0 0 343 347 27477BA9 2747813B 0 0 7 0 0 1388 168 0 1 DIST1 3F800000 \
                            00000000 FFF92230 1388 3 0 3E8 7D0 1 RSSI1 3F800000 00000000 FFF92230 1388 3 0 FE 10 0 0 0 0 0";

    #[test]
    fn a_telegram_of_the_listing_is_read_field_by_field() {
        let data = ScanData::parse(TELEGRAM.as_bytes()).unwrap();
        assert_eq!((data.scan_counter, data.measured_us, data.sent_us), (0x347, 0x2747_7BA9, 0x2747_813B));
        assert_eq!((data.scan_frequency, data.start_angle_deg, data.angle_step_deg), (50.0, -45.0, 0.5));
        assert_eq!(data.ranges, [0.0, 1.0, 2.0]);
        assert_eq!(data.strengths, [0, 0xFE, 0x10]);
    }

    #[test]
    fn a_scale_factor_of_two_doubles_the_ranges() {
        let data = ScanData::parse(TELEGRAM.replacen("3F800000", "40000000", 1).as_bytes()).unwrap();
        assert_eq!(data.ranges, [0.0, 2.0, 4.0]);
    }

    #[test]
    fn what_is_wrong_is_named() {
        let error = |text: &str| ScanData::parse(text.as_bytes()).unwrap_err().to_string();
        assert!(error("sRA STlms 7 0").contains("STlms"));
        assert!(error("sSN LMDscandata 1 1").contains("end before the serial number"));
        assert!(error(&TELEGRAM.replace("3E8", "3G8")).contains("a beam of the scan data is '3G8'"));
        assert!(error(&TELEGRAM.replace("3E8", "1FFFF")).contains("16 bits"));
        assert!(error(&TELEGRAM.replacen("3F800000", "7F800000", 1)).contains("a scale factor"));
        assert!(error(&TELEGRAM.replace("FFF92230 1388 3 0 3E8", "FFF92230 1388 FFFFFFF 0 3E8")).contains("the fan"));
        assert!(error(&TELEGRAM.replace(" 1388 168", " 0 168")).contains("scan frequency"));
        assert!(error(&TELEGRAM.replace("1388 3 0 FE 10", "1388 2 0 FE")).contains("3 ranges but 2 strengths"));
    }

    proptest! {
        #[test]
        fn any_text_and_any_cut_of_a_telegram_is_read_or_refused(text in "[ -~]{0,80}", cut in 0..200usize, flip in 0..200usize) {
            let _ = ScanData::parse(text.as_bytes());
            let mut bytes = TELEGRAM.as_bytes().to_vec();
            let at = flip.min(bytes.len() - 1);
            bytes[at] ^= 0x15;
            bytes.truncate(cut);
            if let Ok(data) = ScanData::parse(&bytes) {
                prop_assert!(data.ranges.iter().all(|r| r.is_finite()));
            }
        }
    }
}
