//! What a load is made of: kinds of calls, sizes of surfaces, numbers of points, and when what is sent.
//!
//! Purpose: reads amounts as the command line has them; [`Arrivals`] of a Poisson process, and [`Items`], the calls one after the
//! other. Invariant: what was read can be asked for; the same seed gives the same plan, whatever the server does. Must not know:
//! clocks, how it is asked.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
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
        if self.is_one() { write!(f, "{}", self.least) } else { write!(f, "{}..{}", self.least, self.most) }
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

/// The part of the random numbers that arrivals have to themselves.
const ARRIVALS: u64 = u64::MAX;

fn random(seed: u64, stream: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(stream);
    rng
}

/// From 0 to 1, without 1.
fn unit(rng: &mut ChaCha8Rng) -> f64 {
    (rng.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}

/// Times of a Poisson process whose rate rises linearly and then stays: callers that know nothing of each other.
#[derive(Clone, Debug)]
pub(super) struct Arrivals {
    rng: ChaCha8Rng,
    rate: f64,
    ramp_s: f64,
    /// Arrivals that were to be expected up to the last one.
    expected: f64,
}

impl Arrivals {
    /// `rate` a second, after a rise of `ramp`.
    pub(super) fn new(rate: f64, ramp: Duration, seed: u64) -> Self {
        Self { rng: random(seed, ARRIVALS), rate, ramp_s: ramp.as_secs_f64(), expected: 0.0 }
    }
}

impl Iterator for Arrivals {
    type Item = Duration;

    /// The next one. Gaps of expected arrivals are exponential; where the rate rises they are stretched to fit it.
    fn next(&mut self) -> Option<Duration> {
        self.expected -= (1.0 - unit(&mut self.rng)).ln();
        let (rate, ramp) = (self.rate, self.ramp_s);
        let in_ramp = rate * ramp / 2.0;
        let all = self.expected;
        let at = if all < in_ramp { (2.0 * all * ramp / rate).sqrt() } else { all / rate + ramp / 2.0 };
        Duration::try_from_secs_f64(at).ok()
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Item {
    pub(super) kind: Kind,
    pub(super) mesh: usize,
    /// For the server's random points, so that no two results are alike.
    pub(super) random_seed: u64,
    /// If it is to be cancelled: after which part of the usual time.
    pub(super) cancel: Option<f64>,
}

#[derive(Clone, Debug)]
pub(super) struct Items {
    rng: ChaCha8Rng,
    mix: Mix,
    meshes: usize,
    cancel: f64,
}

impl Items {
    /// Of the sender number `sender`, with one of `meshes` surfaces each; the part `cancel` of them is cancelled.
    pub(super) fn new(mix: Mix, meshes: usize, cancel: f64, seed: u64, sender: u64) -> Self {
        Self { rng: random(seed, sender), mix, meshes, cancel }
    }

    /// The next call. Each takes as many random numbers, so that another mix leaves the rest as it was.
    pub(super) fn take(&mut self) -> Item {
        let [kind, mesh, cancel, when] = std::array::from_fn(|_| unit(&mut self.rng));
        let random_seed = self.rng.next_u64() >> 1;
        let mesh = ((mesh * self.meshes as f64) as usize).min(self.meshes.saturating_sub(1));
        Item { kind: self.mix.at(kind), mesh, random_seed, cancel: (cancel < self.cancel).then_some(when) }
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
            counts[mix.at((f64::from(i) + 0.5) / 6000.0) as usize] += 1;
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
        assert!(Kind::ALL.iter().enumerate().all(|(place, kind)| *kind as usize == place));
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

    fn gaps(rate: f64, seed: u64, count: usize) -> Vec<f64> {
        let times: Vec<f64> =
            Arrivals::new(rate, Duration::ZERO, seed).take(count + 1).map(|at| at.as_secs_f64()).collect();
        times.windows(2).map(|pair| pair[1] - pair[0]).collect()
    }

    #[test]
    fn gaps_are_those_of_a_poisson_process() {
        let (rate, count) = (50.0, 40_000);
        let gaps = gaps(rate, 1, count);
        let mean = gaps.iter().sum::<f64>() / count as f64;
        let variance = gaps.iter().map(|gap| (gap - mean).powi(2)).sum::<f64>() / count as f64;
        assert!((mean * rate - 1.0).abs() < 0.02, "{mean}");
        assert!((variance * rate * rate - 1.0).abs() < 0.06, "{variance}");
        // Counts of a second have as much variance as mean.
        let mut counts = vec![0.0; (0.9 * count as f64 / rate) as usize];
        for at in Arrivals::new(rate, Duration::ZERO, 2).take(count) {
            if let Some(second) = counts.get_mut(at.as_secs() as usize) {
                *second += 1.0;
            }
        }
        let n = counts.len() as f64;
        let mean = counts.iter().sum::<f64>() / n;
        let variance = counts.iter().map(|count: &f64| (count - mean).powi(2)).sum::<f64>() / n;
        assert!((0.8..1.25).contains(&(variance / mean)), "{variance} {mean}");
        // A gap says nothing about the next.
        let bound: f64 = 1.0 / rate;
        let covariance = gaps.windows(2).map(|pair| (pair[0] - bound) * (pair[1] - bound)).sum::<f64>();
        assert!((covariance / count as f64 * rate * rate).abs() < 0.03);
    }

    #[test]
    fn the_rate_rises_linearly() {
        let ramp = Duration::from_secs(100);
        let before = |s: u64| {
            let end = Duration::from_secs(s);
            Arrivals::new(200.0, ramp, 5).take_while(|at| *at < end).count() as f64
        };
        // A quarter of the rise has a sixteenth of its arrivals; the rise has half of those of the full rate.
        for (end, expected) in [(25, 625.0), (50, 2500.0), (100, 10_000.0), (150, 20_000.0)] {
            let found = before(end);
            assert!((found - expected).abs() < 4.0 * expected.sqrt(), "{end} s: {found}, not {expected}");
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_plan() {
        let times = |seed| Arrivals::new(9.0, Duration::from_secs(2), seed).take(100).collect::<Vec<_>>();
        assert!(times(7) == times(7) && times(7) != times(8));
        assert!(times(7).is_sorted());
        let items = |mix: &str, seed, sender| {
            let mut items = Items::new(mix.parse().unwrap(), 5, 0.25, seed, sender);
            (0..400).map(|_| items.take()).collect::<Vec<_>>()
        };
        let all = items("remesh=1,rvd=1", 7, 0);
        assert_eq!(all, items("remesh=1,rvd=1", 7, 0));
        assert_ne!(all, items("remesh=1,rvd=1", 7, 1));
        assert_ne!(all, items("remesh=1,rvd=1", 8, 0));
        let other = items("info", 7, 0);
        assert!(
            all.iter().zip(&other).all(|(a, b)| (a.mesh, a.random_seed, a.cancel) == (b.mesh, b.random_seed, b.cancel))
        );
        let cancelled = all.iter().filter(|item| item.cancel.is_some()).count();
        assert!((60..140).contains(&cancelled), "{cancelled}");
        assert!((0..5).all(|mesh| all.iter().any(|item| item.mesh == mesh)));
    }
}
