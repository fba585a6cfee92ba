//! When calls are sent, and what each asks.
//!
//! Purpose: [`Arrivals`] of a Poisson process, and [`Items`], the calls one after the other.
//! Invariant: the same seed gives the same plan, whatever the server does. Must not know: clocks, calls.

use std::time::Duration;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::amounts::{Kind, Mix};

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
        let at = match self.expected < in_ramp {
            true => (2.0 * self.expected * ramp / rate).sqrt(),
            false => self.expected / rate + ramp / 2.0,
        };
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
