//! Long vectors, block by block.
//!
//! Purpose: what a quasi-Newton step does with vectors in as few passes over memory as it takes, on one thread or several:
//! each pass changes a vector and has the product with the one that comes next.
//! Invariant: sums are of blocks of one size, added up in their order, so that threads change no bit.
//! Must not know: what the vectors mean to an optimiser.

use rayon::prelude::*;

use crate::knn::{Point, Threads};
use crate::rvd::{CellSums, Evaluation};

/// Seeds in a block: a few vectors of this length stay in a core's own cache.
const BLOCK: usize = 1024;

/// What comes of each block, in their order.
fn each<A: Send, R: Send>(
    threads: Threads,
    blocks: impl Iterator<Item = A>,
    of: impl Fn(A) -> R + Send + Sync,
) -> Vec<R> {
    match threads {
        Threads::One => blocks.map(of).collect(),
        Threads::Pool => blocks.collect::<Vec<_>>().into_par_iter().map(of).collect(),
    }
}

/// The gradient from what a pass found, ∇E_i = 2 m_i (x_i - c_i), 0 for seeds that are held, into `g`; and what the pass
/// says as a whole, with the gradient along `d` for its slope.
pub(super) fn evaluate<P: Point>(
    threads: Threads,
    sums: &CellSums<P>,
    held: &[bool],
    d: &[P],
    g: &mut Vec<P>,
) -> Evaluation {
    g.resize(held.len(), P::ZERO);
    let of_cells = sums.moment.chunks(BLOCK).zip(sums.energy.chunks(BLOCK)).zip(sums.area.chunks(BLOCK));
    let of_seeds = g.chunks_mut(BLOCK).zip(held.chunks(BLOCK)).zip(d.chunks(BLOCK));
    let evaluations = each(threads, of_cells.zip(of_seeds), |(((moment, energy), area), ((g, held), d))| {
        for ((g, &moment), &held) in g.iter_mut().zip(moment).zip(held) {
            // Minus twice the moment about the seed, so that nothing cancels.
            *g = if held { P::ZERO } else { moment * -2.0 };
        }
        Evaluation {
            energy: energy.iter().sum(),
            gradient_squared: dot(g, g),
            slope: dot(g, d),
            empty_cells: area.iter().filter(|&&a| a <= 0.0).count(),
            area: area.iter().sum(),
            ..Evaluation::default()
        }
    });
    evaluations.iter().fold(Evaluation::default(), |all, one| Evaluation {
        energy: all.energy + one.energy,
        gradient_squared: all.gradient_squared + one.gradient_squared,
        slope: all.slope + one.slope,
        empty_cells: all.empty_cells + one.empty_cells,
        area: all.area + one.area,
        ..all
    })
}

/// One over twice the mass, which makes a seed's part of the gradient the way from its centroid; 0 without mass.
fn preconditioner(mass: f64) -> f64 {
    let preconditioner = 0.5 / mass;
    if preconditioner.is_finite() { preconditioner } else { 0.0 }
}

/// Computes `yᵀPy`, where `P` divides by twice the masses.
pub(super) fn preconditioned<P: Point>(threads: Threads, y: &[P], mass: &[f64]) -> f64 {
    let blocks = y.chunks(BLOCK).zip(mass.chunks(BLOCK));
    let products = each(threads, blocks, |(y, mass)| {
        y.iter().zip(mass).map(|(y, &mass)| preconditioner(mass) * y.length_squared()).sum::<f64>()
    });
    products.iter().sum()
}

/// Sets `d := -g`, or `-P g` with masses. Returns the product of `d` with `with`.
pub(super) fn negate<P: Point>(threads: Threads, g: &[P], mass: Option<&[f64]>, d: &mut [P], with: &[P]) -> f64 {
    let blocks = d.chunks_mut(BLOCK).zip(g.chunks(BLOCK)).zip(with.chunks(BLOCK)).enumerate();
    let products = each(threads, blocks, |(block, ((d, g), with))| {
        d.iter_mut().zip(g).for_each(|(d, &g)| *d = -g);
        if let Some(mass) = mass {
            divide(d, 1.0, &mass[block * BLOCK..]);
        }
        dot(d, with)
    });
    products.iter().sum()
}

/// Sets `d := d + factor · v`, and then `scale · P d` with a scale and masses. Returns the product of `d` with `with`.
pub(super) fn add<P: Point>(
    threads: Threads,
    d: &mut [P],
    (factor, v): (f64, &[P]),
    scale: Option<(f64, &[f64])>,
    with: &[P],
) -> f64 {
    let blocks = d.chunks_mut(BLOCK).zip(v.chunks(BLOCK)).zip(with.chunks(BLOCK)).enumerate();
    let products = each(threads, blocks, |(block, ((d, v), with))| {
        d.iter_mut().zip(v).for_each(|(d, &v)| *d += v * factor);
        if let Some((scale, mass)) = scale {
            divide(d, scale, &mass[block * BLOCK..]);
        }
        dot(d, with)
    });
    products.iter().sum()
}

fn divide<P: Point>(d: &mut [P], scale: f64, mass: &[f64]) {
    d.iter_mut().zip(mass).for_each(|(d, &mass)| *d *= scale * preconditioner(mass));
}

/// Sets `s := x' - x` and `y := g' - g`. Returns `s·s`, `y·y` and `s·y`.
pub(super) fn differences<P: Point>(
    threads: Threads,
    [x_then, x]: [&[P]; 2],
    [g_then, g]: [&[P]; 2],
    [s, y]: [&mut Vec<P>; 2],
) -> [f64; 3] {
    s.resize(x.len(), P::ZERO);
    y.resize(x.len(), P::ZERO);
    let steps = s.chunks_mut(BLOCK).zip(x_then.chunks(BLOCK)).zip(x.chunks(BLOCK));
    let changes = y.chunks_mut(BLOCK).zip(g_then.chunks(BLOCK)).zip(g.chunks(BLOCK));
    let products = each(threads, steps.zip(changes), |(((s, x_then), x), ((y, g_then), g))| {
        difference(x_then, x, s);
        difference(g_then, g, y);
        [dot(s, s), dot(y, y), dot(s, y)]
    });
    products.iter().fold([0.0; 3], |all, one| [all[0] + one[0], all[1] + one[1], all[2] + one[2]])
}

fn difference<P: Point>(a: &[P], b: &[P], out: &mut [P]) {
    out.iter_mut().zip(a).zip(b).for_each(|((out, &a), &b)| *out = a - b);
}

/// In four sums side by side: one alone waits for each addition.
fn dot<P: Point>(a: &[P], b: &[P]) -> f64 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<4>(), b.as_chunks::<4>());
    let mut sums = [P::ZERO; 4];
    for (a, b) in a.iter().zip(b) {
        (0..4).for_each(|k| sums[k] += a[k].times(b[k]));
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a.dot(*b)).sum();
    ((sums[0] + sums[1]) + (sums[2] + sums[3])).element_sum() + rest
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    #[test]
    fn threads_change_no_bit() {
        let n = 3 * BLOCK + 77;
        let vector = |k: usize| -> Vec<DVec3> {
            (0..n).map(|i| DVec3::new((i * k) as f64, 1.0, (i + k) as f64).map(f64::sin)).collect()
        };
        let mass: Vec<f64> = (0..n).map(|i| if i % 50 == 0 { 0.0 } else { 1.0 + i as f64 }).collect();
        let run = |threads| {
            let (g, v, w) = (vector(1), vector(2), vector(3));
            let mut d = vec![DVec3::ZERO; n];
            let first = negate(threads, &g, Some(&mass), &mut d, &v);
            let second = negate(threads, &g, None, &mut d, &v);
            let third = add(threads, &mut d, (0.3, &v), Some((1.7, &mass)), &w);
            let fourth = preconditioned(threads, &v, &mass);
            let (mut s, mut y) = (Vec::new(), Vec::new());
            let fifth = differences(threads, [&d, &g], [&v, &w], [&mut s, &mut y]);
            ([first, second, third, fourth], fifth, d, s, y)
        };
        let alone = run(Threads::One);
        assert!(run(Threads::Pool) == alone);
        let ([first, second, third, fourth], [s_squared, y_squared, curvature], d, s, y) = alone;
        let product = |a: &[DVec3], b: &[DVec3]| a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum::<f64>();
        let near = |a: f64, b: f64| assert!((a - b).abs() <= 1e-12 * n as f64, "{a} for {b}");
        let over = |a: &[DVec3]| -> Vec<DVec3> {
            a.iter().zip(&mass).map(|(&a, &m)| if m > 0.0 { a / (2.0 * m) } else { DVec3::ZERO }).collect()
        };
        let (g, v) = (vector(1), vector(2));
        near(first, -product(&over(&g), &v));
        near(second, -product(&g, &v));
        near(third, product(&d, &vector(3)));
        near(fourth, product(&over(&v), &v));
        near(s_squared, product(&s, &s));
        near(y_squared, product(&y, &y));
        near(curvature, product(&s, &y));
        let sum: Vec<DVec3> = g.iter().zip(&v).map(|(&g, &v)| 1.7 * (0.3 * v - g)).collect();
        assert!(d.iter().zip(over(&sum)).all(|(d, want)| d.abs_diff_eq(want, 1e-15)));
    }
}
