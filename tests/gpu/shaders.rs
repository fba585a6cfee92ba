//! Promise: every shader is valid WGSL and every record has one layout on both sides. No GPU.

use std::path::Path;

use ::gpu::diagram::shaders::{LIFTED, SOURCES, compose};
use ::gpu::diagram::{layout, plan};
use naga::valid::{Capabilities, ValidationFlags, Validator};

fn parse(stage: &str, slots: i64, array: i64) -> naga::Module {
    parse_with(stage, slots, array, 0)
}

/// Every variant, as slots are gone through.
fn members(slots: i64) -> i64 {
    i64::from(layout::MEMBERS[slots as usize % layout::MEMBERS.len()])
}

fn parse_with(stage: &str, slots: i64, array: i64, shared: i64) -> naga::Module {
    parse_in(stage, slots, array, shared, 0)
}

fn parse_in(stage: &str, slots: i64, array: i64, shared: i64, lifted: i64) -> naga::Module {
    let constants = [
        ("SLOTS", slots),
        ("ARRAY", array),
        ("SHARED", shared),
        ("ROW", i64::from(layout::ROW)),
        ("LIST", i64::from(layout::LIST)),
        ("WIDTH", i64::from(if shared == 0 { layout::ROW } else { layout::LIST })),
        ("PART", plan::SEARCH_PART as i64),
        ("LONGER", i64::from(layout::LONGER)),
        ("MOST", i64::from(layout::MOST_REQUEUED)),
        ("MEMBERS", members(slots)),
        ("WEIGHTED", shared),
        ("PAIRS", layout::PAIRS as i64),
        ("LENGTHENERS", i64::from(layout::LENGTHENERS)),
        ("DOTS", layout::DOTS as i64),
        ("WIDE", 0),
        ("LIFTED", lifted),
    ];
    let source = compose(stage, &constants).unwrap();
    let module = naga::front::wgsl::parse_str(&source)
        .unwrap_or_else(|e| panic!("{stage}, {slots} slots:\n{}", e.emit_to_string(&source)));
    Validator::new(ValidationFlags::all(), Capabilities::empty())
        .validate(&module)
        .unwrap_or_else(|e| panic!("{stage}, {slots} slots:\n{}", e.emit_to_string(&source)));
    module
}

/// Names below `shaders/`, as in `#import`.
fn files(folder: &Path, below: &str, out: &mut Vec<String>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let entry = entry.unwrap();
        let name = format!("{below}{}", entry.file_name().to_string_lossy());
        if entry.path().is_dir() {
            files(&entry.path(), &format!("{name}/"), out);
        } else {
            out.push(name.strip_suffix(".wgsl").unwrap().to_owned());
        }
    }
}

#[test]
fn every_file_is_listed_and_no_two_have_one_name() {
    let mut found = Vec::new();
    files(&Path::new(env!("CARGO_MANIFEST_DIR")).join("shaders"), "", &mut found);
    found.sort_unstable();
    assert_eq!(found, SOURCES.iter().map(|(name, _)| *name).collect::<Vec<_>>());
    let mut names: Vec<&str> = found.iter().map(|name| name.rsplit('/').next().unwrap()).collect();
    names.sort_unstable();
    let twice: Vec<_> = names.windows(2).filter(|two| two[0] == two[1]).collect();
    assert!(twice.is_empty(), "{twice:?}");
}

#[test]
fn every_stage_is_valid_for_every_size() {
    for (stage, _) in SOURCES.iter().filter(|(name, _)| !name.starts_with("shared/")) {
        for slots in 4..=16 {
            parse(stage, slots, 0);
            parse_with(stage, slots, 0, 1);
        }
        parse(stage, 64, 1);
    }
}

#[test]
fn no_stage_binds_more_storage_buffers_than_webgpu_guarantees() {
    for (stage, _) in SOURCES.iter().filter(|(name, _)| !name.starts_with("shared/")) {
        let module = parse(stage, 10, 0);
        let storage = module
            .global_variables
            .iter()
            .filter(|(_, v)| matches!(v.space, naga::AddressSpace::Storage { .. }))
            .count();
        assert!(storage <= ::gpu::device::STORAGE_BUFFERS as usize, "{stage}: {storage}");
    }
}

/// (name, offset) of every member, and the size.
fn reflected(module: &naga::Module, name: &str) -> (Vec<(String, u32)>, u32) {
    let found = module.types.iter().find(|(_, t)| t.name.as_deref() == Some(name));
    let naga::TypeInner::Struct { members, span } = &found.unwrap_or_else(|| panic!("no {name}")).1.inner else {
        panic!("{name} is no struct");
    };
    (members.iter().map(|m| (m.name.clone().unwrap(), m.offset)).collect(), *span)
}

macro_rules! same_layout {
    ($module:expr, $name:ident $fields:tt) => {
        same_layout!($module, $name = $name $fields)
    };
    ($module:expr, $name:ident = $twin:ident { $($field:ident),* $(,)? }) => {{
        let twin = vec![$((stringify!($field).to_owned(), std::mem::offset_of!(layout::$twin, $field) as u32)),*];
        assert_eq!(reflected($module, stringify!($name)), (twin, size_of::<layout::$twin>() as u32));
    }};
}

#[test]
fn records_have_one_layout() {
    let clip = parse("clip/clip", 10, 0);
    same_layout!(&clip, Seed { hi, row_begin, lo, row_length });
    same_layout!(
        &clip,
        Facet {
            hi,
            slot_begin,
            lo,
            slot_mask,
            e1,
            corner1_u,
            e2,
            corner2_u,
            n,
            corner2_v,
            weight,
            weight_u,
            weight_v,
            weight_top
        }
    );
    same_layout!(
        &clip,
        Params {
            mass_scale,
            moment_scale,
            energy_scale,
            area_scale,
            uniform_weights,
            list_capacity,
            batch,
            enqueue_begin,
            enqueue_count,
            enqueue_root,
            emit_begin,
            emit_count,
            polygon,
            accumulate,
            grid,
            zero,
            seeds,
            row,
            side,
            roots,
            divided,
            facet_first,
            part_first,
            has_lists,
            longest_lift
        }
    );
    same_layout!(
        &clip,
        State {
            head,
            begin,
            end,
            length,
            failures,
            pieces,
            list_overflow,
            cells_overflow,
            halt,
            near,
            duplicates,
            unproved,
            bad,
            cursor,
            paired,
            rounds,
            longer,
            requeued,
            overflowed
        }
    );
    same_layout!(&parse("neighbours/search", 10, 0), Sorted { hi, seed, lo, first });
    // The words behind it are counted from its end.
    for (stage, name) in [("neighbours/count", "ListState"), ("neighbours/search", "ListStateRead")] {
        let (mut members, _) = reflected(&parse(stage, 10, 0), name);
        assert_eq!(members.pop(), Some(("words".to_owned(), size_of::<layout::ListState>() as u32)));
        let of = |offset: usize| offset as u32;
        let fields = [
            ("drift", of(std::mem::offset_of!(layout::ListState, drift))),
            ("fast", of(std::mem::offset_of!(layout::ListState, fast))),
            ("open", of(std::mem::offset_of!(layout::ListState, open))),
            ("made", of(std::mem::offset_of!(layout::ListState, made))),
            ("mode", of(std::mem::offset_of!(layout::ListState, mode))),
        ];
        let named: Vec<(&str, u32)> = members.iter().map(|(name, offset)| (name.as_str(), *offset)).collect();
        assert_eq!(named[..fields.len()], fields);
    }
    let gradient = parse("optimizer/gradient", 10, 0);
    same_layout!(
        &gradient,
        OptimizerParams {
            seeds,
            groups,
            step,
            slot,
            directed,
            uniform_weights,
            moment_per_mass,
            gradient_unit,
            coefficients,
            least_area,
            most_area,
            mean_mass,
            used,
            padding
        }
    );
    same_layout!(
        &gradient,
        Totals { energy_low, energy_high, area_low, area_high, empty, gradient_squared, slope, padding }
    );
}

#[test]
fn stages_of_lifted_surfaces_are_valid_and_their_records_have_one_layout() {
    for stage in LIFTED {
        for slots in 4..=16 {
            parse_in(stage, slots, 0, 0, 1);
            parse_in(stage, slots, 0, 1, 1);
        }
        parse_in(stage, 64, 1, 0, 1);
    }
    let clip = parse_in("clip/clip", 10, 0, 0, 1);
    same_layout!(&clip, Seed = LiftedSeed { hi, row_begin, lo, row_length, lift_hi, lift_lo });
    same_layout!(
        &clip,
        Facet = LiftedFacet {
            hi,
            slot_begin,
            lo,
            slot_mask,
            e1,
            corner1_u,
            e2,
            corner2_u,
            lift_hi,
            corner2_v,
            weight,
            weight_u,
            weight_v,
            weight_top,
            lift_lo,
            lift_e1,
            lift_e2
        }
    );
    let search = parse_in("neighbours/search", 10, 0, 0, 1);
    same_layout!(&search, Sorted = LiftedSorted { hi, seed, lo, first, lift_hi, lift_lo });
    let constants = [("SLOTS", 10), ("ARRAY", 0), ("SHARED", 0), ("WIDE", 0), ("LIFTED", 1)];
    let words = format!("const SUM_WORDS: u32 = {}u;", layout::LIFTED_SUM_WORDS);
    assert!(compose("clip/clip", &constants).unwrap().contains(&words));
}

#[test]
fn constants_agree() {
    let text = compose("clip/clip", &[("SLOTS", 10), ("ARRAY", 0), ("SHARED", 0), ("WIDE", 0)]).unwrap();
    for line in [
        format!("const COMPLETE: u32 = {:#x}u;", layout::COMPLETE),
        format!("const ROOT: u32 = {:#x}u;", layout::ROOT),
        format!("const INDEX: u32 = {:#x}u;", layout::INDEX),
        format!("const NEIGHBOURS: u32 = {}u;", layout::code::NEIGHBOURS),
        format!("const POLYGON: u32 = {}u;", layout::code::POLYGON),
        format!("const FINISH: u32 = {}u;", layout::code::FINISH),
        format!("const SUM_WORDS: u32 = {}u;", layout::SUM_WORDS),
        format!("const BY_CELL: u32 = {:#x}u;", layout::BY_CELL),
        format!("const DIRECT: u32 = {}u;", layout::accumulate::DIRECT),
        format!("const TWO_PHASE: u32 = {}u;", layout::accumulate::TWO_PHASE),
        format!("const NOWHERE: u32 = {}u;", layout::accumulate::NOWHERE),
        format!("const FACET_EDGE: u32 = {:#x}u;", geometry::rvd::cells::FACET_EDGE),
    ] {
        assert!(text.contains(&line), "{line}");
    }
    let row = i64::from(layout::ROW);
    let constants = [("ROW", row), ("WIDTH", row), ("PART", 1), ("PAIRS", layout::PAIRS as i64)];
    let all = [
        "neighbours/count",
        "clip/enqueue",
        "neighbours/search",
        "optimizer/partial_dots",
        "optimizer/centroids",
        "optimizer/may_step",
    ];
    let text: String = all.iter().map(|stage| compose(stage, &constants).unwrap()).collect();
    for line in [
        format!("const NONE: u32 = {:#x}u;", layout::NONE),
        format!("const BAD: u32 = {}u;", layout::halt::BAD),
        format!("const FAR: u32 = {}u;", layout::halt::FAR),
        format!("const GRID_OVERFLOW: u32 = {}u;", layout::halt::GRID_OVERFLOW),
        format!("const INCOMPLETE: u32 = {}u;", layout::halt::INCOMPLETE),
        format!("const RINGS: i32 = {};", layout::RINGS),
        // Room for the most products that are added up together, and odd.
        format!("const TOGETHER: u32 = {}u;", (layout::DOTS - layout::PLAIN_DOTS) | 1),
        format!("const SUM_WORDS: u32 = {}u;", layout::SUM_WORDS),
        format!("const ACCEPTED: f32 = {:e};", tessera::rvd::MAX_SEED_DISTANCE),
    ] {
        assert!(text.contains(&line), "{line}");
    }
}
