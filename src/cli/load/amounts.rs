//! What a load is made of, as it is written on the command line: kinds of calls, sizes of surfaces, numbers of points.
//!
//! Invariant: what was read can be asked for. Must not know: how it is asked.

use std::fmt;
use std::str::FromStr;

use strum::{EnumString, IntoStaticStr, VariantArray, VariantNames};

use geometry::mesh::shapes::MAX_FACETS;
use server::config::whole;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, EnumString, IntoStaticStr, VariantArray, VariantNames)]
#[strum(serialize_all = "kebab-case")]
pub(super) enum Kind {
    Remesh,
    Rvd,
    /// The stream `Cvt`: a session of a few steps.
    Cvt,
    /// A remesh as a job of `JobService`: upload, create, watch, download.
    RemeshJob,
    RvdJob,
    /// `GetServerInfo`, which does no work: what the way to the server costs.
    Info,
}

impl Kind {
    pub(super) const ALL: &[Self] = <Self as VariantArray>::VARIANTS;

    pub(super) fn name(self) -> &'static str {
        self.into()
    }

    pub(super) fn place(self) -> usize {
        self as usize
    }

    pub(super) fn is_job(self) -> bool {
        matches!(self, Self::RemeshJob | Self::RvdJob)
    }

    /// Whether it brings a surface and takes a result.
    pub(super) fn is_work(self) -> bool {
        self != Self::Info
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Mix(Vec<(Kind, f64)>);

impl Mix {
    /// The kinds, each with its part of all.
    pub(super) fn parts(&self) -> impl Iterator<Item = (Kind, f64)> + '_ {
        let all: f64 = self.0.iter().map(|(_, weight)| weight).sum();
        self.0.iter().map(move |(kind, weight)| (*kind, weight / all))
    }

    /// The kind at `u` of 0 to 1.
    pub(super) fn at(&self, u: f64) -> Kind {
        let mut left = u;
        let mut last = Kind::RemeshJob;
        for (kind, part) in self.parts() {
            last = kind;
            left -= part;
            if left < 0.0 {
                break;
            }
        }
        last
    }

    /// Without the kinds that `keep` does not want; none if nothing is left.
    pub(super) fn only_those(&self, keep: impl Fn(Kind) -> bool) -> Option<Self> {
        let left: Vec<_> = self.0.iter().copied().filter(|(kind, _)| keep(*kind)).collect();
        (!left.is_empty()).then_some(Self(left))
    }
}

impl fmt::Display for Mix {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let all: Vec<String> =
            self.parts().map(|(kind, part)| format!("{} {:.0} %", kind.name(), 100.0 * part)).collect();
        f.write_str(&all.join(", "))
    }
}

impl FromStr for Mix {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut all: Vec<(Kind, f64)> = Vec::new();
        for part in text.split(',').map(str::trim) {
            let (name, weight) = part.split_once('=').unwrap_or((part, "1"));
            let kind: Kind = name.trim().parse().map_err(|_| {
                format!("there is no kind of call {name:?}; there are {}", <Kind as VariantNames>::VARIANTS.join(", "))
            })?;
            let weight = weight.trim().parse::<f64>().ok().filter(|weight| (1e-6..=1e6).contains(weight));
            let weight = weight.ok_or_else(|| format!("{part}: a weight is a number above 0, as in {name}=2"))?;
            if all.iter().any(|(there, _)| *there == kind) {
                return Err(format!("{name} is there twice"));
            }
            all.push((kind, weight));
        }
        Ok(Self(all))
    }
}

/// How many facets a surface has: from the least to the most, each power of ten as likely as the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Sizes {
    least: usize,
    most: usize,
}

impl Sizes {
    pub(super) fn is_one(self) -> bool {
        self.least == self.most
    }

    /// The size at `u` of 0 to 1.
    pub(super) fn at(self, u: f64) -> usize {
        let (least, most) = (self.least as f64, self.most as f64);
        let size = least * (most / least).powf(u.clamp(0.0, 1.0));
        (size.round() as usize).clamp(self.least, self.most)
    }
}

impl fmt::Display for Sizes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.is_one() {
            true => write!(f, "{}", self.least),
            false => write!(f, "{}..{}", self.least, self.most),
        }
    }
}

impl FromStr for Sizes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (least, most) = text.split_once("..").unwrap_or((text, text));
        match (whole(least.trim()), whole(most.trim())) {
            (Ok(least), Ok(most)) if 1 <= least && least <= most && most <= MAX_FACETS => Ok(Self { least, most }),
            _ => Err(format!("facets are written as 10000 or 1000..20000, from 1 to {MAX_FACETS}")),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Points {
    Count(u64),
    Part(f64),
}

impl Points {
    pub(super) fn of(self, facets: usize) -> u64 {
        /// Fewer may be too few for the topology of a made surface.
        const LEAST: u64 = 100;
        match self {
            Self::Count(points) => points,
            Self::Part(part) => ((facets as f64 * part).round() as u64).max(LEAST),
        }
    }
}

impl fmt::Display for Points {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Count(points) => write!(f, "{points}"),
            Self::Part(part) => write!(f, "{}%", 100.0 * part),
        }
    }
}

impl FromStr for Points {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || "points are written as 500, or as a part of the facets: 10%".to_owned();
        match text.strip_suffix('%') {
            Some(percent) => {
                let percent = percent.trim().parse::<f64>().ok().filter(|percent| (0.001..=10_000.0).contains(percent));
                percent.map(|percent| Self::Part(percent / 100.0)).ok_or_else(wrong)
            }
            None => whole::<u64>(text).ok().filter(|points| *points > 0).map(Self::Count).ok_or_else(wrong),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mix_has_its_parts() {
        let mix: Mix = "remesh-job=4, remesh,rvd=1.0".parse().unwrap();
        let mut counts = [0; 6];
        for i in 0..6000 {
            counts[mix.at((f64::from(i) + 0.5) / 6000.0).place()] += 1;
        }
        assert_eq!(counts, [1000, 1000, 0, 4000, 0, 0]);
        assert_eq!(mix.to_string(), "remesh-job 67 %, remesh 17 %, rvd 17 %");
        assert_eq!(mix.at(1.0), Kind::Rvd);
        for bad in ["", "remesh=0", "remesh=x", "bake", "remesh,remesh=2", "remesh=-1", "remesh=inf", "remesh,"] {
            assert!(bad.parse::<Mix>().is_err(), "{bad:?}");
        }
        let only = "info,rvd=3".parse::<Mix>().unwrap().only_those(Kind::is_work);
        assert_eq!(only, Some(Mix(vec![(Kind::Rvd, 3.0)])));
        assert_eq!("info".parse::<Mix>().unwrap().only_those(Kind::is_work), None);
        assert!(Kind::ALL.iter().enumerate().all(|(place, kind)| kind.place() == place));
    }

    #[test]
    fn sizes_are_spread_by_factors() {
        let sizes: Sizes = "1000..100000".parse().unwrap();
        assert_eq!([0.0, 0.5, 1.0].map(|u| sizes.at(u)), [1000, 10_000, 100_000]);
        let one: Sizes = "2e3".parse().unwrap();
        assert!(one.is_one() && one.at(0.3) == 2000 && one.to_string() == "2000");
        for bad in ["", "0", "..", "9..3", "1..", "x", "-4", "1..1e12"] {
            assert!(bad.parse::<Sizes>().is_err(), "{bad:?}");
        }
    }

    #[test]
    fn points_are_a_count_or_a_part() {
        assert_eq!("500".parse::<Points>().unwrap().of(9), 500);
        assert_eq!("10%".parse::<Points>().unwrap().of(20_000), 2000);
        assert_eq!("1%".parse::<Points>().unwrap().of(10), 100);
        for bad in ["", "0", "%", "-5%", "0.1", "x%", "inf%"] {
            assert!(bad.parse::<Points>().is_err(), "{bad:?}");
        }
    }
}
