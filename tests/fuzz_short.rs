//! Promise: what the fuzzers in `tests/fuzz/` look for is looked for in every test run too, with fixed cases.
//!
//! `TESSERA_FUZZ_CASES=1000000 cargo test --release --test fuzz_short -- --ignored --nocapture cpu` makes the long
//! run on all cores (`TESSERA_FUZZ_THREADS` of them); `TESSERA_FUZZ_FIRST` begins it elsewhere, so that with
//! `TESSERA_FUZZ_CASES=1` it does one failing case again. `gpu` instead of `cpu` is the same on the GPU.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "common/cases.rs"]
mod cases;
#[path = "common/gpu.rs"]
mod gpu;
#[path = "common/gpu_cases.rs"]
mod gpu_cases;
#[path = "common/readers.rs"]
mod readers;
#[path = "common/uploads.rs"]
mod uploads;

use std::path::PathBuf;
use std::time::Instant;

use glam::dvec2;
use needs::needs;
use rand::{Rng, RngExt, SeedableRng};
use tessera::internals::rvd::Gpu;
use tessera::mesh::attributes::{Attributes, ColourDepth, Colours, Normals, PerCorner};
use tessera::mesh::io::{Format, encode, encode_with_attributes};
use tessera::mesh::shapes::Shape;
use tessera::rvd::Parallel;

type Check<'a> = &'a (dyn Fn(&cases::Case) -> Result<(), String> + Sync);

fn number(variable: &str, default: u64) -> u64 {
    std::env::var(variable).map_or(default, |text| text.parse().unwrap_or_else(|e| panic!("{variable}={text}: {e}")))
}

fn run(first: u64, count: u64, threads: usize, check: Check<'_>) {
    let begin = Instant::now();
    let made = cases::run(first, count, threads, check).unwrap_or_else(|failures| panic!("\n{}", failures.join("\n")));
    eprintln!("{made} cases of {count} in {:.1} s", begin.elapsed().as_secs_f64());
    assert!(2 * made >= count.saturating_sub(1), "most bytes make a case");
}

/// As the variables in the module's head say.
fn run_long(check: Check<'_>, threads: usize) {
    let threads = number("TESSERA_FUZZ_THREADS", threads as u64) as usize;
    run(number("TESSERA_FUZZ_FIRST", 0), number("TESSERA_FUZZ_CASES", 100_000), threads, check);
}

fn cpu() -> impl Fn(&cases::Case) -> Result<(), String> + Sync {
    // Two threads: enough to share tasks out, few enough to leave the cores to the cases.
    let parallel = Parallel::new(Some(2)).unwrap();
    move |case| cases::check(case, &parallel)
}

#[test]
fn small_diagrams() {
    run(0, 2000, 2, &cpu());
}

#[test]
#[ignore = "the long run; TESSERA_FUZZ_CASES says how many"]
fn many_small_diagrams_cpu() {
    run_long(&cpu(), std::thread::available_parallelism().map_or(1, usize::from));
}

#[needs(gpu)]
#[test]
fn small_diagrams_on_the_gpu() {
    let Some(device) = gpu::device() else { return };
    let gpu = Gpu::new(device, Some(1)).unwrap();
    run(0, 40, 1, &|case| gpu_cases::check(case, &gpu));
}

#[needs(gpu)]
#[test]
#[ignore = "the long run; TESSERA_FUZZ_CASES says how many"]
fn many_small_diagrams_gpu() {
    let Some(device) = gpu::device() else { return };
    let gpu = Gpu::new(device, Some(1)).unwrap();
    run_long(&|case| gpu_cases::check(case, &gpu), 1);
}

/// The inputs in `tests/fuzz/corpus`, so that what a fuzzer found once is looked at for ever.
#[test]
fn committed_corpora() {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/corpus");
    let cpu = cpu();
    let mut looked_at = 0;
    for folder in std::fs::read_dir(&root).unwrap().map(|e| e.unwrap().path()) {
        for file in std::fs::read_dir(&folder).unwrap().map(|e| e.unwrap().path()) {
            let bytes = std::fs::read(&file).unwrap();
            let name = folder.file_name().unwrap().to_str().unwrap();
            let outcome = match (Format::from_extension(name), name) {
                (Some(format), _) => readers::check(format, &bytes),
                (None, "upload") => uploads::check(&bytes).map(|_| ()),
                (None, "rvd") => cases::Case::from_bytes(&bytes).map_or(Ok(()), |case| cpu(&case)),
                (None, other) => panic!("no target {other}"),
            };
            outcome.unwrap_or_else(|text| panic!("{}: {text}", file.display()));
            looked_at += 1;
        }
    }
    assert!(looked_at > 10, "{looked_at} inputs in {}", root.display());
}

/// Files with a few bytes changed, dropped or doubled, in all formats.
#[test]
fn changed_files() {
    let mesh = Shape::Torus.build(24);
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    let count = mesh.positions().len();
    let mut attributes = Attributes::new(&mesh);
    let corners: Vec<[u32; 3]> = (0..mesh.facets().len() as u32).map(|f| [f, f + 1, 0]).collect();
    let values = (0..=corners.len()).map(|i| dvec2(i as f64, 0.5)).collect();
    attributes.set_texture(PerCorner { values, corners }).unwrap();
    attributes.set_normals(Normals::PerVertex(mesh.positions().to_vec())).unwrap();
    attributes.set_colours(Colours { values: vec![[0.2, 0.4, 0.6, 0.8]; count], depth: ColourDepth::Eight }).unwrap();
    attributes.add_scalar("density", vec![1.5; count]).unwrap();
    for format in Format::ALL {
        let carrying = encode_with_attributes(format, &mesh, &attributes).unwrap().0;
        let originals = [encode(format, &mesh).unwrap(), carrying];
        for round in 0..800 {
            let mut bytes = originals[round % 2].clone();
            for _ in 0..rng.random_range(1..6) {
                let at = rng.random_range(0..bytes.len());
                let end = (at + rng.random_range(1..40)).min(bytes.len());
                match rng.random_range(0..5) {
                    0 => bytes[at] = rng.random_range(0..=255),
                    1 => bytes[at] = b"0123456789 \n-./e#"[rng.random_range(0..17)],
                    2 => drop(bytes.drain(at..end)),
                    3 => bytes.extend_from_within(at..end),
                    _ => bytes.truncate(at.max(1)),
                }
                if bytes.is_empty() {
                    break;
                }
            }
            readers::check(format, &bytes).unwrap_or_else(|text| panic!("{format:?}, round {round}: {text}"));
        }
    }
}

/// Recordings of clients that err, and noise.
#[test]
fn uploads_in_any_order() {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(6);
    let mut taken = 0;
    for round in 0..20_000 {
        let mut bytes = vec![0; rng.random_range(1..300)];
        rng.fill_bytes(&mut bytes);
        // A client that errs in one byte of 32 makes few whole uploads of many chunks.
        if round % 2 == 0 {
            bytes.iter_mut().skip(1).for_each(|b| *b &= 0x7e | u8::from(round % 4 == 0));
        }
        taken += usize::from(uploads::check(&bytes).unwrap_or_else(|text| panic!("round {round}: {text}")));
    }
    assert!((1000..19_000).contains(&taken), "{taken} were taken");
}
