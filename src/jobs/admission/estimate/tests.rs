//! Needs grow with every count, and never overflow.

mod calibration;

use proptest::prelude::*;

use super::*;

const KINDS: [Kind; 3] = [Kind::Remesh, Kind::Rvd, Kind::Cvt];
const BACKENDS: [BackendKind; 3] = [BackendKind::Serial, BackendKind::Parallel, BackendKind::Gpu];
const DENSITIES: [DensitySource; 8] = [
    DensitySource::Uniform,
    DensitySource::Weights,
    DensitySource::EdgeLengths,
    DensitySource::Curvature,
    DensitySource::Lfs,
    DensitySource::Error,
    DensitySource::ErrorMax,
    DensitySource::Metric,
];

/// From few to more than there can be.
fn count() -> impl Strategy<Value = u64> {
    (0u32..64, any::<u64>()).prop_map(|(bits, number)| number >> bits)
}

prop_compose! {
    fn any_counts()(
        kind in 0usize..3, backend in 0usize..3, density in 0usize..DENSITIES.len(), flags in 0u8..64,
        numbers in prop::array::uniform9(count()),
    ) -> Counts {
        let [vertices, facets, points, steps, input_bytes, attributes, list_bytes, sets, extra_pairs] = numbers;
        Counts {
            kind: KINDS[kind],
            backend: BACKENDS[backend],
            vertices,
            facets,
            points,
            steps,
            input_bytes,
            density: DENSITIES[density],
            placement: if flags & 1 == 0 { Placement::Fitted } else { Placement::Surface },
            anisotropy: if flags & 32 == 0 { Anisotropy::None } else { Anisotropy::Auto },
            attributes,
            list_bytes,
            refines: flags & 2 != 0,
            measures: flags & 4 != 0,
            cells: flags & 8 != 0,
            sets,
            extra_pairs,
            is_crowded: flags & 16 != 0,
        }
    }
}

fn grows(from: &Need, to: &Need) -> bool {
    from.memory.fits(to.memory) && from.seconds <= to.seconds
}

proptest! {
    #[test]
    fn more_of_anything_needs_no_less(counts in any_counts(), more in count(), which in 0usize..14, threads in 0usize..300) {
        let mut larger = counts;
        let number = match which {
            0 => &mut larger.vertices,
            1 => &mut larger.facets,
            2 => &mut larger.points,
            3 => &mut larger.steps,
            4 => &mut larger.input_bytes,
            5 => &mut larger.list_bytes,
            6 => &mut larger.sets,
            7 => &mut larger.extra_pairs,
            _ => &mut larger.attributes,
        };
        *number = number.saturating_add(more);
        match which {
            8 => larger.refines = true,
            9 => larger.measures = true,
            10 => larger.cells = true,
            11 => larger.is_crowded = true,
            12 => larger.anisotropy = Anisotropy::Share(1.0),
            _ => {}
        }
        let (before, after) = (need(&counts, threads), need(&larger, threads));
        // Few steps leave more to the repair.
        let is_uneven = which == 3 && counts.kind == Kind::Remesh && (counts.steps as f64) < EVEN_STEPS;
        let seconds = if is_uneven { after.seconds.max(before.seconds) } else { after.seconds };
        // The plan of a lifted surface has neither lists nor drifts of grid cells, so that few facets need less of the device.
        let is_lifted = counts.anisotropy == Anisotropy::None && larger.anisotropy != Anisotropy::None;
        let device = if is_lifted { after.memory.device.max(before.memory.device) } else { after.memory.device };
        let memory = Bytes { device, ..after.memory };
        prop_assert!(grows(&before, &Need { memory, seconds }), "{counts:?} {before:?} {after:?}");
        prop_assert!(before.seconds.is_finite() && before.seconds > 0.0);
        prop_assert!(before.memory.host >= MIB);
        prop_assert_eq!(before.memory.device > 0, counts.backend == BackendKind::Gpu);
    }

    #[test]
    fn more_threads_take_more_memory_and_less_time(counts in any_counts(), threads in 0usize..300, more in 0usize..300) {
        let (few, many) = (need(&counts, threads), need(&counts, threads + more));
        prop_assert!(few.memory.host <= many.memory.host && few.seconds >= many.seconds);
    }
}

#[test]
fn the_most_of_everything_is_a_number() {
    let most = Counts {
        steps: u64::MAX,
        attributes: u64::MAX,
        list_bytes: u64::MAX,
        sets: u64::MAX,
        extra_pairs: u64::MAX,
        refines: true,
        ..Counts::new(Kind::Remesh, BackendKind::Gpu, u64::MAX, u64::MAX, u64::MAX)
    };
    let need = need(&most, usize::MAX);
    assert_eq!(need.memory, Bytes::MAX);
    assert!(need.seconds.is_finite());
}

/// Bytes that sessions really had (`memory.device_bytes` of reports of llvmpipe).
const ON_DEVICE: [(Kind, u64, u64, DensitySource, u64); 5] = [
    (Kind::Remesh, 69_451, 10_000, DensitySource::Uniform, 48_038_700),
    (Kind::Remesh, 999_492, 100_000, DensitySource::Uniform, 326_364_028),
    (Kind::Remesh, 64, 50_000, DensitySource::Uniform, 69_331_216),
    (Kind::Remesh, 99_938, 50_000, DensitySource::Lfs, 93_962_328),
    (Kind::Rvd, 999_492, 100_000, DensitySource::Uniform, 299_854_544),
];

#[test]
fn device_bytes_are_those_of_sessions() {
    for (kind, facets, points, density, measured) in ON_DEVICE {
        let counts = Counts { density, ..Counts::new(kind, BackendKind::Gpu, facets / 2, facets, points) };
        let ratio = need(&counts, 2).memory.device as f64 / measured as f64;
        // Graded seeds may crowd, and need a finer grid then; none did here.
        let most = if density == DensitySource::Uniform { 1.1 } else { 3.0 };
        assert!((0.95..most).contains(&ratio), "{facets} facets, {points} points: {ratio}");
    }
}

/// Facets, points, and bytes that sessions of lifted surfaces had.
const LIFTED_ON_DEVICE: [(u64, u64, u64); 2] = [(19_908, 2000, 32_396_060), (6000, 3000, 23_129_528)];

#[test]
fn device_bytes_are_those_of_sessions_of_lifted_surfaces() {
    for (facets, points, measured) in LIFTED_ON_DEVICE {
        let counts = Counts::new(Kind::Remesh, BackendKind::Gpu, facets / 2, facets, points);
        let counts = Counts { anisotropy: Anisotropy::Auto, ..counts };
        let ratio = need(&counts, 2).memory.device as f64 / measured as f64;
        // Seeds may crowd in space, and need a finer grid then; none did here.
        assert!((0.95..3.0).contains(&ratio), "{facets} facets, {points} points: {ratio}");
    }
}

/// Seconds of whole remeshes and of steps, two threads (docs/performance.md).
#[test]
fn seconds_are_within_a_factor_of_two_of_those_in_the_documents() {
    let remesh = |facets, points, steps| {
        let counts = Counts::new(Kind::Remesh, BackendKind::Parallel, facets / 2, facets, points);
        need(&Counts { steps, ..counts }, 2).seconds
    };
    let step = |facets, points| remesh(facets, points, 1035) - remesh(facets, points, 35);
    let cases = [
        ("the bunny", remesh(69_451, 10_000, 35), 0.75),
        // CPU time, since the repair uses both threads for a part of it only.
        ("a torus, one step", remesh(150_164, 10_000, 1), 9.3),
        ("a coarse torus, one step", remesh(2000, 10_000, 1), 3.0),
        ("a coarse torus, 10 steps", remesh(2000, 10_000, 10), 1.1),
        ("few points, one step", remesh(150_164, 200, 1), 2.2),
        ("nefertiti", remesh(99_938, 50_000, 35), 2.35),
        ("steps of the bunny", step(69_451, 10_000), 2.7),
        ("steps of rocker-arm", step(20_088, 15_000), 4.5),
        ("steps of nefertiti", step(99_938, 50_000), 14.0),
        ("steps of a torus", step(1_000_000, 1_000_000), 245.0),
    ];
    for (what, predicted, measured) in cases {
        assert!((0.5..2.0).contains(&(predicted / measured)), "{what}: {predicted} for {measured}");
    }
}
