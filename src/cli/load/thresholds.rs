//! Thresholds that a load must keep, as `p99>2s` or `errors>0`.
//!
//! Invariant: a threshold on a latency that was not measured is crossed: a check that saw nothing proves nothing.
//! Must not know: how anything is measured.

use std::fmt;
use std::str::FromStr;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Unit {
    Seconds,
    /// A number of calls, or a part of all that were to be sent.
    Count,
    Number,
}

/// Figures that a threshold may name. Latencies and rates are those of jobs with a result.
const FIGURES: [(&str, Unit); 13] = [
    ("p50", Unit::Seconds),
    ("p90", Unit::Seconds),
    ("p99", Unit::Seconds),
    ("p999", Unit::Seconds),
    ("max", Unit::Seconds),
    ("mean", Unit::Seconds),
    ("errors", Unit::Count),
    ("refused", Unit::Count),
    ("dropped", Unit::Count),
    ("late", Unit::Count),
    ("cancelled", Unit::Count),
    ("rate", Unit::Number),
    (MISMATCHES, Unit::Number),
];

/// Rows in which the server counted differently.
const MISMATCHES: &str = "mismatches";

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Than {
    More,
    Less,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Threshold {
    text: String,
    figure: &'static str,
    unit: Unit,
    than: Than,
    /// Whether the bound itself crosses it.
    or_equal: bool,
    bound: f64,
    /// Whether the bound is a part of all.
    is_part: bool,
}

impl Threshold {
    /// Whether it is about a comparison with the server's counts.
    pub(super) fn needs_comparison(&self) -> bool {
        self.figure == MISMATCHES
    }

    /// What was found, in words, if it is crossed. `found` says what there is, in seconds, counts or jobs a second; `all` is
    /// how many were to be sent.
    pub(super) fn crossed(&self, found: impl Fn(&str) -> Option<f64>, all: u64) -> Option<String> {
        let Some(value) = found(self.figure) else { return Some(format!("{self}: nothing was measured")) };
        let value = if self.is_part { value / (all.max(1) as f64) } else { value };
        let crossed = match self.than {
            Than::More => value > self.bound,
            Than::Less => value < self.bound,
        } || (self.or_equal && value == self.bound);
        crossed.then(|| match (self.unit, self.is_part) {
            (Unit::Seconds, _) => format!("{self}: it is {value:.3} s"),
            (_, true) => format!("{self}: it is {:.2} %", 100.0 * value),
            (Unit::Count, false) => format!("{self}: it is {value}"),
            (Unit::Number, false) => format!("{self}: it is {value:.2}"),
        })
    }
}

impl fmt::Display for Threshold {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl FromStr for Threshold {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let text: String = text.chars().filter(|c| !c.is_whitespace()).collect();
        let at = text.find(['<', '>']).ok_or("a threshold is written as p99>2s, errors>0 or refused>1%")?;
        let (name, rest) = text.split_at(at);
        let than = if rest.starts_with('>') { Than::More } else { Than::Less };
        let (or_equal, bound) = rest[1..].strip_prefix('=').map_or((false, &rest[1..]), |bound| (true, bound));
        let known = FIGURES.into_iter().find(|(known, _)| *known == name.to_ascii_lowercase());
        let (figure, unit) = known.ok_or_else(|| {
            let names = FIGURES.map(|(name, _)| name);
            format!("there is no figure {name:?}; there are {}", names.join(", "))
        })?;
        let wrong = |words: &str| format!("{text}: {words}");
        let number = |text: &str| text.parse::<f64>().ok().filter(|number| number.is_finite() && *number >= 0.0);
        let (bound, is_part) = match unit {
            Unit::Seconds => (seconds(bound).ok_or_else(|| wrong("a time has a unit, as 300ms, 2s or 1m"))?, false),
            Unit::Count => match bound.strip_suffix('%') {
                Some(percent) => (number(percent).ok_or_else(|| wrong("a part is written as 1%"))? / 100.0, true),
                None => (number(bound).ok_or_else(|| wrong("a count is written as 0, a part as 1%"))?, false),
            },
            Unit::Number => (number(bound).ok_or_else(|| wrong("a number is written as 5 or 0.5"))?, false),
        };
        Ok(Self { text, figure, unit, than, or_equal, bound, is_part })
    }
}

fn seconds(text: &str) -> Option<f64> {
    let units = [("us", 1e-6), ("ms", 1e-3), ("s", 1.0), ("m", 60.0)];
    let (number, unit) = units.iter().find_map(|(name, unit)| Some((text.strip_suffix(name)?, unit)))?;
    number.parse::<f64>().ok().filter(|number| number.is_finite() && *number >= 0.0).map(|number| number * unit)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn crossed(text: &str, value: Option<f64>) -> bool {
        text.parse::<Threshold>().unwrap().crossed(|_| value, 200).is_some()
    }

    #[test]
    fn a_threshold_is_crossed_beyond_its_bound() {
        for (text, below, above) in [
            ("p99>2s", 2.0, 2.001),
            ("p50 > 300ms", 0.3, 0.301),
            ("max>=1m", 59.0, 60.0),
            ("p999>500us", 0.0004, 0.0006),
            ("errors>0", 0.0, 1.0),
            ("refused>1%", 2.0, 3.0),
            ("dropped>=1", 0.0, 1.0),
            ("mismatches>0", 0.0, 1.0),
        ] {
            assert!(!crossed(text, Some(below)) && crossed(text, Some(above)), "{text}");
        }
        assert!(crossed("rate<5", Some(4.9)) && !crossed("rate<5", Some(5.0)) && crossed("rate<=5", Some(5.0)));
        assert!(crossed("p99>2s", None), "nothing measured is nothing proved");
        let said = "refused>1%".parse::<Threshold>().unwrap().crossed(|_| Some(5.0), 200);
        assert_eq!(said.as_deref(), Some("refused>1%: it is 2.50 %"));
    }

    #[test]
    fn what_says_nothing_is_refused() {
        for bad in
            ["", "p99", "p99>2", "p99=2s", "p98>2s", "errors>x", "errors>-1", "rate<5%", "refused>%", "p99>infs", ">1"]
        {
            assert!(bad.parse::<Threshold>().is_err(), "{bad:?}");
        }
    }
}
