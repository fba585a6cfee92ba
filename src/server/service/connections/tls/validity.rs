//! From when to when a certificate is good.
//!
//! Purpose: reads the two dates of an X.509 certificate, for a warning before its expiry.
//! Invariant: no read goes beyond the bytes; unknown content gives `None`. Only TLS decides whether a certificate is valid.
//! Must not know: files.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Tags of DER.
const INTEGER: u8 = 0x02;
const UTC_TIME: u8 = 0x17;
const GENERALIZED_TIME: u8 = 0x18;
const SEQUENCE: u8 = 0x30;
/// The version, which the oldest certificates do not have.
const VERSION: u8 = 0xa0;

/// Seconds since 1970: the first that is good, and the last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Validity {
    from: i64,
    until: i64,
}

impl Validity {
    /// Of a certificate in DER.
    pub(super) fn of(certificate: &[u8]) -> Option<Self> {
        let mut outer = Reader(certificate);
        let mut signed = Reader(Reader(outer.element(SEQUENCE)?).element(SEQUENCE)?);
        if signed.0.first() == Some(&VERSION) {
            signed.element(VERSION)?;
        }
        signed.element(INTEGER)?;
        // Signature algorithm and issuer.
        signed.element(SEQUENCE)?;
        signed.element(SEQUENCE)?;
        let mut dates = Reader(signed.element(SEQUENCE)?);
        Some(Self { from: dates.time()?, until: dates.time()? })
    }

    /// Whether the certificate is valid now.
    pub(super) fn is_now(self) -> bool {
        let now = now();
        self.from <= now && now <= self.until
    }

    /// Whether the certificate is valid now and for `time` more.
    pub(super) fn is_for(self, time: Duration) -> bool {
        let time = i64::try_from(time.as_secs()).unwrap_or(i64::MAX);
        self.is_now() && now().saturating_add(time) <= self.until
    }

    /// Its last day, as year-month-day.
    pub(super) fn until(self) -> String {
        let (year, month, day) = date(self.until.div_euclid(DAY));
        format!("{year:04}-{month:02}-{day:02}")
    }
}

/// Seconds.
const DAY: i64 = 86_400;

fn now() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_secs()).unwrap_or(i64::MAX)
}

/// Elements of DER, one after the other.
struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    /// Content of the next element, if it has this tag.
    fn element(&mut self, tag: u8) -> Option<&'a [u8]> {
        match self.next()? {
            (found, held) if found == tag => Some(held),
            _ => None,
        }
    }

    fn next(&mut self) -> Option<(u8, &'a [u8])> {
        let (&tag, rest) = self.0.split_first()?;
        let (&first, rest) = rest.split_first()?;
        let (length, rest) = match first {
            0..=0x7f => (usize::from(first), rest),
            // Four bytes of length are more than any certificate has.
            0x81..=0x84 => {
                let (bytes, rest) = rest.split_at_checked(usize::from(first - 0x80))?;
                (bytes.iter().fold(0, |length, byte| length << 8 | usize::from(*byte)), rest)
            }
            _ => return None,
        };
        let (held, rest) = rest.split_at_checked(length)?;
        self.0 = rest;
        Some((tag, held))
    }

    fn time(&mut self) -> Option<i64> {
        let (tag, text) = self.next()?;
        let text = std::str::from_utf8(text).ok()?.strip_suffix('Z')?;
        let (year, rest) = match tag {
            UTC_TIME => {
                let (year, rest) = text.split_at_checked(2)?;
                let year: i64 = year.parse().ok()?;
                // The century by RFC 5280.
                (if year < 50 { 2000 + year } else { 1900 + year }, rest)
            }
            GENERALIZED_TIME => {
                let (year, rest) = text.split_at_checked(4)?;
                (year.parse().ok()?, rest)
            }
            _ => return None,
        };
        if rest.len() != 10 || !rest.bytes().all(|byte| byte.is_ascii_digit()) {
            return None;
        }
        let part = |at: usize| rest.get(at..at + 2)?.parse::<i64>().ok();
        let [month, day, hour, minute, second] = [part(0)?, part(2)?, part(4)?, part(6)?, part(8)?];
        if !(1..=12).contains(&month) {
            return None;
        }
        Some(days(year, month, day) * DAY + hour * 3600 + minute * 60 + second)
    }
}

/// Days from 1970-01-01 to a date of the Gregorian calendar. Years begin in March, so that a leap day is last; 400 years
/// have 146,097 days.
fn days(year: i64, month: i64, day: i64) -> i64 {
    let year = if month <= 2 { year - 1 } else { year };
    let (era, of_era) = (year.div_euclid(400), year.rem_euclid(400));
    let of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    era * 146_097 + of_era * 365 + of_era / 4 - of_era / 100 + of_year - 719_468
}

/// The date of a day, as [`days`] counts them.
fn date(day: i64) -> (i64, i64, i64) {
    let day = day + 719_468;
    let (era, of_era) = (day.div_euclid(146_097), day.rem_euclid(146_097));
    let year = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year + year / 4 - year / 100);
    let month = (5 * of_year + 2) / 153;
    let day = of_year - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    (era * 400 + year + i64::from(month <= 2), month, day)
}

#[cfg(test)]
mod tests {
    use rcgen::{CertificateParams, KeyPair, date_time_ymd};

    use super::*;

    fn certificate(from: (i32, u8, u8), until: (i32, u8, u8)) -> Vec<u8> {
        let mut params = CertificateParams::new(["localhost".to_owned()]).unwrap();
        params.not_before = date_time_ymd(from.0, from.1, from.2);
        params.not_after = date_time_ymd(until.0, until.1, until.2);
        params.self_signed(&KeyPair::generate().unwrap()).unwrap().der().to_vec()
    }

    #[test]
    fn the_dates_of_certificates_are_read() {
        for (from, until, now) in [
            ((1975, 1, 1), (4096, 1, 1), true),
            ((2000, 2, 29), (2049, 12, 31), true),
            ((1999, 12, 31), (2000, 3, 1), false),
            ((2100, 1, 1), (2100, 2, 28), false),
        ] {
            let validity = Validity::of(&certificate(from, until)).unwrap();
            assert_eq!(validity.is_now(), now, "{from:?}");
            let (year, month, day) = until;
            assert_eq!(validity.until(), format!("{year:04}-{month:02}-{day:02}"));
            assert!(!validity.is_for(Duration::MAX));
        }
        let bytes = certificate((2000, 1, 1), (2001, 1, 1));
        assert_eq!(Validity::of(&bytes).map(|v| v.from), Some(946_684_800));
        for end in 0..bytes.len() {
            // A truncated certificate causes no panic: the outer length shows that bytes are missing.
            assert_eq!(Validity::of(&bytes[..end]), None);
        }
        for at in 0..bytes.len() {
            let mut other = bytes.clone();
            other[at] ^= 0xff;
            let _ = Validity::of(&other);
        }
    }

    #[test]
    fn days_are_those_of_the_calendar() {
        for (year, month, day, count) in
            [(1970, 1, 1, 0), (2000, 2, 29, 11_016), (2000, 3, 1, 11_017), (2026, 11, 23, 20_780), (1969, 12, 31, -1)]
        {
            assert_eq!((days(year, month, day), date(count)), (count, (year, month, day)));
        }
        for day in -200_000..400_000 {
            let (y, m, d) = date(day);
            assert_eq!(days(y, m, d), day);
        }
    }
}
