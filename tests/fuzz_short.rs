//! Promise: what the fuzzers in `tests/fuzz/` look for is looked for in every test run too, with fixed inputs that shrink.
//!
//! Properties are in `common/properties.rs`, for both. What breaks one here is shrunk, and its bytes are printed: put them into a file
//! in `tests/fuzz/corpus`, and `committed_corpora` looks at them for ever.
//!
//! `TESSERA_FUZZ_CASES=1000000 cargo test --release --test fuzz_short -- --ignored --nocapture cpu` makes the long
//! run on all cores (`TESSERA_FUZZ_THREADS` of them); `TESSERA_FUZZ_FIRST` begins it elsewhere. `gpu` instead of `cpu` is the same
//! on the GPU.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "common/properties.rs"]
mod properties;
#[path = "common/shrinking.rs"]
mod shrinking;

use std::io::Write as _;
use std::path::PathBuf;
use std::time::Instant;

use glam::dvec2;
use needs::needs;
use properties::Held;
use proptest::collection::vec;
use proptest::prelude::{Strategy, any};
use tessera::mesh::attributes::{Attributes, ColourDepth, Colours, Normals, PerCorner, Scalar};
use tessera::mesh::io::{Format, encode, encode_with_attributes};
use tessera::mesh::shapes::Shape;

fn number(variable: &str, default: u64) -> u64 {
    std::env::var(variable).map_or(default, |text| text.parse().unwrap_or_else(|e| panic!("{variable}={text}: {e}")))
}

/// Bytes that make a small surface with seeds.
fn bytes() -> impl Strategy<Value = Vec<u8>> {
    vec(any::<u8>(), 24..512)
}

fn small(first: u64, count: u64, threads: usize, property: fn(&[u8]) -> Held) {
    let begin = Instant::now();
    let made = shrinking::hold([first, count], threads, bytes, |bytes| property(bytes))
        .unwrap_or_else(|failures| panic!("\n{}", failures.join("\n")));
    eprintln!("{made} cases of {count} in {:.1} s", begin.elapsed().as_secs_f64());
    assert!(2 * made >= count.saturating_sub(1), "most bytes make a case");
}

/// As the variables in the module's head say.
fn many(threads: usize, property: fn(&[u8]) -> Held) {
    let threads = number("TESSERA_FUZZ_THREADS", threads as u64) as usize;
    small(number("TESSERA_FUZZ_FIRST", 0), number("TESSERA_FUZZ_CASES", 100_000), threads, property);
}

#[test]
fn small_diagrams() {
    small(0, 2000, 2, properties::diagram);
}

#[test]
#[ignore = "the long run; TESSERA_FUZZ_CASES says how many"]
fn many_small_diagrams_cpu() {
    many(std::thread::available_parallelism().map_or(1, usize::from), properties::diagram);
}

#[needs(gpu)]
#[test]
fn small_diagrams_on_the_gpu() {
    if properties::gpu::device().is_some() {
        small(0, 50, 1, properties::diagram_on_the_gpu);
    }
}

#[test]
#[ignore = "the long run; TESSERA_FUZZ_CASES says how many"]
fn many_small_diagrams_gpu() {
    if properties::gpu::device().is_some() {
        many(1, properties::diagram_on_the_gpu);
    }
}

/// A property that breaks is told with the smallest input that breaks it.
#[test]
fn a_failure_is_made_small() {
    let small_bytes = |bytes: &Vec<u8>| match bytes.iter().find(|&&byte| byte >= 200) {
        Some(byte) => Err(format!("{byte} is large")),
        None => Ok(true),
    };
    let failures = shrinking::hold([0, 1], 1, || vec(any::<u8>(), 0..512), small_bytes).unwrap_err();
    assert_eq!(failures, ["block 0: 200 is large\n  the smallest input: [200]"]);
}

/// The inputs in `tests/fuzz/corpus`, so that what a fuzzer found once is looked at for ever.
#[test]
fn committed_corpora() {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/corpus");
    let mut looked_at = 0;
    for folder in std::fs::read_dir(&root).unwrap().map(|e| e.unwrap().path()) {
        for file in std::fs::read_dir(&folder).unwrap().map(|e| e.unwrap().path()) {
            let name = folder.file_name().unwrap().to_str().unwrap();
            let outcome = properties::of_corpus(name, &std::fs::read(&file).unwrap());
            outcome.unwrap_or_else(|text| panic!("{}: {text}", file.display()));
            looked_at += 1;
        }
    }
    assert!(looked_at > 10, "{looked_at} inputs in {}", root.display());
}

/// One change of a file: what, where (as a share of its length), how much, and a value.
type Edit = (u8, u16, u8, u8);

/// A file with a few bytes changed, dropped or doubled.
fn edited(original: &[u8], edits: &[Edit]) -> Vec<u8> {
    let mut bytes = original.to_vec();
    for &(kind, place, length, value) in edits {
        if bytes.is_empty() {
            break;
        }
        let at = usize::from(place) * bytes.len() / (usize::from(u16::MAX) + 1);
        let end = (at + 1 + usize::from(length % 39)).min(bytes.len());
        match kind % 5 {
            0 => bytes[at] = value,
            1 => bytes[at] = b"0123456789 \n-./e#"[usize::from(value) % 17],
            2 => drop(bytes.drain(at..end)),
            3 => bytes.extend_from_within(at..end),
            _ => bytes.truncate(at.max(1)),
        }
    }
    bytes
}

/// Changed files, in all formats, with attributes and without, and packed by gzip.
#[test]
fn changed_files() {
    let mesh = Shape::Torus.build(24);
    let count = mesh.positions().len();
    let mut attributes = Attributes::new(&mesh);
    let corners: Vec<[u32; 3]> = (0..mesh.facets().len() as u32).map(|f| [f, f + 1, 0]).collect();
    let values = (0..=corners.len()).map(|i| dvec2(i as f64, 0.5)).collect();
    attributes.set_texture(PerCorner { values, corners }).unwrap();
    attributes.set_normals(Normals::PerVertex(mesh.positions().to_vec())).unwrap();
    attributes.set_colours(Colours { values: vec![[0.2, 0.4, 0.6, 0.8]; count], depth: ColourDepth::Eight }).unwrap();
    attributes.add_scalar(Scalar::new("density", vec![1.5; count])).unwrap();
    for format in Format::ALL {
        let carrying = encode_with_attributes(format, &mesh, &attributes).unwrap().0;
        let mut packer = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
        packer.write_all(&carrying).unwrap();
        let originals = [encode(format, &mesh).unwrap(), carrying, packer.finish().unwrap()];
        let edits = || (0..3usize, vec(any::<Edit>(), 1..6));
        let property = |(which, edits): &(usize, Vec<Edit>)| {
            let bytes = edited(&originals[*which], edits);
            let told = |text: String| format!("{format:?}: {text}\n  the file: {}", String::from_utf8_lossy(&bytes));
            properties::file(format, &bytes).map_err(told)
        };
        let outcome = shrinking::hold([0, 1200], 1, edits, property);
        outcome.unwrap_or_else(|failures| panic!("\n{}", failures.join("\n")));
    }
}

/// Recordings of clients that err, and noise.
#[test]
fn uploads_in_any_order() {
    let inputs = || {
        (vec(any::<u8>(), 1..300), 0..4u8).prop_map(|(mut bytes, kind)| {
            // A client that errs in one byte of 32 makes few whole uploads of many chunks.
            if kind % 2 == 0 {
                bytes.iter_mut().skip(1).for_each(|b| *b &= 0x7e | u8::from(kind == 0));
            }
            bytes
        })
    };
    let taken = shrinking::hold([0, 20_000], 2, inputs, |bytes| properties::upload(bytes))
        .unwrap_or_else(|failures| panic!("\n{}", failures.join("\n")));
    assert!((1000..19_000).contains(&taken), "{taken} were taken");
}
