//! Regions come back from every format that holds them, and labels that are none are left aside.

#![allow(clippy::unwrap_used)]

use std::fmt::Write as _;

use super::super::*;
use super::*;
use crate::mesh::shapes::Shape;

/// Names that try writers: spaces, quotes, other letters, none, one that is another's number, two that are the same.
const NAMES: [&str; 9] =
    ["", "steel plate", "steel_plate", "Größe ✓", "7", "a\u{a0}b", "say \"x\"", "# \\", "steel plate"];

/// Facets in slabs across a direction, with regions of such numbers.
fn slabs(mesh: &TriMesh, numbers: &[i64], seed: usize) -> Regions {
    let (low, high) = mesh.bounds();
    let (axis, count) = (seed % 3, numbers.len());
    let of_facet = (0..mesh.facets().len()).map(|facet| {
        let middle = mesh.corners(facet).iter().map(|p| p[axis]).sum::<f64>() / 3.0;
        let share = (middle - low[axis]) / (high[axis] - low[axis]).max(1e-9);
        ((share * count as f64) as usize).min(count - 1) as u32
    });
    let name = |k: usize| NAMES[(k + seed) % NAMES.len()].to_owned();
    let all = numbers.iter().enumerate().map(|(k, &number)| Region { number, name: name(k) });
    Regions::new(of_facet.collect(), all.collect()).unwrap()
}

/// What a format has of each region.
fn held(format: Format, regions: &Regions) -> Option<Vec<String>> {
    let numbers = |range: RangeInclusive<i64>| numbers(regions, &range);
    let text = |numbers: Vec<i64>| numbers.iter().map(i64::to_string).collect();
    Some(match format {
        Format::Off | Format::ThreeMf => return None,
        Format::Obj => names(regions, obj::word),
        Format::Stl => names(regions, str::to_owned),
        Format::Glb | Format::Gltf => (0..regions.all().len()).map(|k| regions.label(k)).collect(),
        Format::Medit | Format::MeditBinary => text(numbers(i32::MIN.into()..=i32::MAX.into())),
        Format::Ply => text(numbers(-(1 << 53) + 1..=(1 << 53) - 1)),
        Format::Vtk | Format::Vtp | Format::Vtu => text(numbers(i64::MIN..=i64::MAX)),
        Format::Gmsh => {
            let names = regions.all().iter().map(|region| gmsh::quoted(&region.name));
            names.zip(numbers(1..=i32::MAX.into())).map(|(name, n)| format!("{n} {name}")).collect()
        }
    })
}

/// What was read of each region.
fn read_back(format: Format, regions: &Regions) -> Vec<String> {
    let text = |k: usize| match format {
        Format::Gmsh => format!("{} {}", regions.all()[k].number, regions.all()[k].name),
        _ => regions.label(k),
    };
    (0..regions.all().len()).map(text).collect()
}

/// The facets as bits of their corners, each with its label, in any order.
fn labelled(mesh: &TriMesh, regions: &Regions, labels: &[String]) -> Vec<([[u32; 3]; 3], String)> {
    let bits = |facet: usize| mesh.corners(facet).map(|p| p.to_array().map(|x| (x as f32 + 0.0).to_bits()));
    let label = |facet: usize| labels[regions.of_facet()[facet] as usize].clone();
    let mut all: Vec<_> = (0..mesh.facets().len()).map(|facet| (bits(facet), label(facet))).collect();
    all.sort_unstable();
    all
}

/// How regions that were written to a file are read.
fn choice(format: Format) -> RegionChoice {
    match format {
        Format::Ply | Format::Vtk | Format::Vtp | Format::Vtu => RegionChoice::Array("regions".to_owned()),
        _ => RegionChoice::Named,
    }
}

fn with_regions(mesh: &TriMesh, regions: &Regions) -> Attributes {
    let mut attributes = Attributes::new(mesh);
    attributes.set_regions(regions.clone()).unwrap();
    attributes
}

#[test]
fn regions_come_back_from_every_format() {
    let sets: [&[i64]; 6] = [
        &[1, 2],
        &[3, 7, 2_000_000_000],
        &[-5, 0, 5, 70_000],
        &[1, 2, 3, 4, 5, 6, 7, 8, 9],
        &[1 << 40, -(1 << 40), 12],
        &[i64::MAX, i64::MIN, 1],
    ];
    for (seed, shape) in Shape::ALL.into_iter().enumerate() {
        let mesh = shape.build(900);
        for (k, numbers) in sets.into_iter().enumerate() {
            let regions = slabs(&mesh, numbers, seed + k);
            let attributes = with_regions(&mesh, &regions);
            for format in Format::ALL {
                let Ok((bytes, left_out)) = encode_with_attributes(format, &mesh, &attributes) else { continue };
                let Some(labels) = held(format, &regions) else {
                    assert!(left_out.contains(&"regions".to_owned()), "{format:?}: {left_out:?}");
                    continue;
                };
                let loaded = decode_with_regions(format, &bytes, &choice(format)).unwrap();
                let what = format!("{shape:?} {numbers:?} {format:?}");
                assert_eq!(loaded.left_aside, [], "{what}");
                let expected = labelled(&mesh, &regions, &labels);
                let used = expected.windows(2).any(|pair| pair[0].1 != pair[1].1);
                let Some(found) = loaded.attributes.regions() else {
                    assert!(!used, "{what}");
                    continue;
                };
                assert_eq!(labelled(&loaded.mesh, found, &read_back(format, found)), expected, "{what}");
                // Other formats keep the order of the facets.
                if !matches!(format, Format::Stl | Format::Glb | Format::Gltf) {
                    let labels_read = read_back(format, found);
                    let read: Vec<&String> = found.of_facet().iter().map(|&k| &labels_read[k as usize]).collect();
                    let own: Vec<&String> = regions.of_facet().iter().map(|&k| &labels[k as usize]).collect();
                    assert_eq!(read, own, "{what}");
                }
                if matches!(format, Format::Glb | Format::Gltf) {
                    assert_eq!(
                        loaded.mesh.positions().len(),
                        decode(format, &encode(format, &mesh).unwrap()).unwrap().positions().len()
                    );
                }
                let (vertices, facets) = counts(format, &bytes).unwrap();
                assert!(vertices >= loaded.mesh.positions().len() as u64, "{what}");
                assert_eq!(facets, mesh.facets().len() as u64, "{what}");
                assert_eq!(
                    left_out.contains(&"names of regions".to_owned()),
                    matches!(
                        format,
                        Format::Ply | Format::Vtk | Format::Vtp | Format::Vtu | Format::Medit | Format::MeditBinary
                    ),
                    "{what}"
                );
                // The rest of the file is as it was.
                let ignored = decode_with_regions(format, &bytes, &RegionChoice::Ignore).unwrap();
                assert_eq!((&ignored.mesh, ignored.attributes.regions()), (&loaded.mesh, None), "{what}");
                // Materials and groups.
                let lines = if format == Format::Obj { 2 } else { 1 };
                assert_eq!(ignored.left_aside.len(), lines, "{what}: {:?}", ignored.left_aside);
            }
        }
    }
}

#[test]
fn what_regions_lose_is_named() {
    let mesh = Shape::Torus.build(200);
    let regions = slabs(&mesh, &[-1, 2, 3], 1);
    let left_out = |format| encode_with_attributes(format, &mesh, &with_regions(&mesh, &regions)).unwrap().1.join("; ");
    assert!(left_out(Format::Gmsh).contains("numbers of regions (they are 1, 2, ...)"));
    assert!(left_out(Format::Obj).contains("\"steel plate\" (it is steel_plate)"), "{}", left_out(Format::Obj));
    assert_eq!(left_out(Format::Medit), "names of regions");
    let bare = Regions::of_numbers(&vec![4; mesh.facets().len()]).unwrap();
    for format in Format::ALL.into_iter().filter(|format| held(*format, &bare).is_some()) {
        let (bytes, left_out) = encode_with_attributes(format, &mesh, &with_regions(&mesh, &bare)).unwrap();
        assert!(left_out.iter().all(|text| text.contains("precision")), "{format:?}: {left_out:?}");
        // One region alone is none.
        let loaded = decode_with_regions(format, &bytes, &choice(format)).unwrap();
        assert_eq!((loaded.attributes.regions(), loaded.left_aside), (None, Vec::new()), "{format:?}");
    }
}

/// A square of n x n quads in rows, each row as a file labels it, with its face as written by `face`.
fn rows(n: usize, mut face: impl FnMut(usize, [usize; 4]) -> String) -> (String, String) {
    let mut points = String::new();
    let mut faces = String::new();
    for y in 0..=n {
        (0..=n).for_each(|x| _ = writeln!(points, "{x} {y} 0"));
    }
    for (y, x) in (0..n).flat_map(|y| (0..n).map(move |x| (y, x))) {
        let corner = y * (n + 1) + x;
        faces += &face(y, [corner, corner + 1, corner + n + 2, corner + n + 1]);
    }
    (points, faces)
}

fn corners(quad: [usize; 4], from: usize) -> String {
    quad.map(|v| (v + from).to_string()).join(" ")
}

/// Checks that each of the rows is a region with this label, both facets of its quads.
fn check_rows(what: &str, loaded: &Loaded, n: usize, label: impl Fn(usize) -> String) {
    let regions = loaded.attributes.regions().unwrap_or_else(|| panic!("{what}: {:?}", loaded.left_aside));
    let read: Vec<String> = regions.of_facet().iter().map(|&k| regions.label(k as usize)).collect();
    let expected: Vec<String> = (0..2 * n * n).map(|facet| label(facet / (2 * n))).collect();
    assert_eq!(read, expected, "{what}");
}

fn named(name: &str) -> RegionChoice {
    RegionChoice::Array(name.to_owned())
}

#[test]
fn facets_of_a_polygon_have_its_label() {
    let n = 5;
    let (points, faces) = rows(n, |y, quad| format!("{y} 3 2 {} {y} {}\n", 7 + y, corners(quad, 1)));
    let nodes: String = (1..).zip(points.lines()).map(|(k, line)| format!("{k} {line}\n")).collect();
    let count = points.lines().count();
    let msh = format!(
        "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n2\n1 7 \"edge\"\n2 7 \"a b\"\n$EndPhysicalNames\n$Nodes\n{count}\n{nodes}$EndNodes\n$Elements\n{}\n{faces}$EndElements\n",
        n * n
    );
    let loaded = decode_with_attributes(Format::Gmsh, msh.as_bytes()).unwrap();
    check_rows("Gmsh", &loaded, n, |y| if y == 0 { "a b".to_owned() } else { (7 + y).to_string() });
    assert_eq!(loaded.left_aside, []);

    let (points, faces) = rows(n, |y, quad| format!("{y}.0 4 {} {y}\n", corners(quad, 0)));
    let ply = format!(
        "ply\nformat ascii 1.0\nelement vertex {count}\nproperty float x\nproperty float y\nproperty float z\nelement face {}\nproperty float part\nproperty list uchar int vertex_indices\nproperty int other\nend_header\n{points}{faces}",
        n * n
    );
    let loaded = decode_with_regions(Format::Ply, ply.as_bytes(), &named("part")).unwrap();
    check_rows("PLY", &loaded, n, |y| y.to_string());
    assert!(loaded.left_aside.iter().any(|e| e.to_string().contains("other")), "{:?}", loaded.left_aside);
    let plain = decode_with_attributes(Format::Ply, ply.as_bytes()).unwrap();
    assert_eq!(plain.attributes.regions(), None);
    assert!(plain.left_aside[0].to_string().contains("--regions NAME"), "{:?}", plain.left_aside);

    let (points, faces) = rows(n, |_, quad| format!("4 {}\n", corners(quad, 0)));
    let values: String = (0..n * n).map(|k| format!("{} ", k / n * 3)).collect();
    // Lines stand behind polygons here, and their values before those of polygons.
    let vtk = format!(
        "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS {count} float\n{points}POLYGONS {} {}\n{faces}LINES 2 6\n2 0 1\n2 1 2\nCELL_DATA {}\nSCALARS part int 1\nLOOKUP_TABLE default\n99 98 {values}\nSCALARS other float 1\nLOOKUP_TABLE default\n1 1 {values}\n",
        n * n,
        5 * n * n,
        n * n + 2
    );
    let loaded = decode_with_regions(Format::Vtk, vtk.as_bytes(), &named("part")).unwrap();
    check_rows("VTK", &loaded, n, |y| (3 * y).to_string());
    let error = decode_with_regions(Format::Vtk, vtk.as_bytes(), &named("region")).unwrap_err();
    assert!(matches!(&error, DataError::NoRegions { there, .. } if *there == ["part", "other"]), "{error}");
    let plain = decode_with_attributes(Format::Vtk, vtk.as_bytes()).unwrap();
    assert!(plain.left_aside.iter().any(|e| e.to_string().contains("\"part\"")), "{:?}", plain.left_aside);
}

#[test]
fn both_readers_of_obj_agree() {
    let n = 6;
    let mut last = usize::MAX;
    let (points, faces) = rows(n, |y, quad| {
        let is_new = std::mem::replace(&mut last, y) != y;
        let label = if is_new { format!("usemtl  Material #{y} x\ng group{}\n", y / 3) } else { String::new() };
        format!("{label}f {}\n", corners(quad, 1))
    });
    let points: String = points.lines().map(|line| format!("v {line}\n")).collect();
    let plain = format!("{points}{faces}");
    let count = points.lines().count();
    // Continued lines, indices from the end, comments: the other reader's.
    let mut other = plain.replace("\nf ", "\nf \\\n ").replacen("usemtl", "# usemtl no\n  usemtl", 1);
    other += &format!("f -{count} 1 1 # 1 1\n");
    let whole = format!("{plain}f 1 1 1\n");
    for (what, text) in [("common", &whole), ("dialects", &other)] {
        let loaded = decode_with_attributes(Format::Obj, text.as_bytes()).unwrap();
        let read = |choice: &RegionChoice| {
            let loaded = decode_with_regions(Format::Obj, text.as_bytes(), choice).unwrap();
            let regions = loaded.attributes.regions().cloned().unwrap();
            (
                regions.all().iter().map(|r| format!("{} {}", r.number, r.name)).collect::<Vec<_>>(),
                regions.of_facet().to_vec(),
            )
        };
        let rows: Vec<u32> = (0..2 * n * n).map(|facet| (facet / (2 * n)) as u32).chain([n as u32 - 1]).collect();
        let (names, of_facet) = read(&RegionChoice::Named);
        assert_eq!(of_facet, rows, "{what}");
        assert_eq!(names[1], "2 Material #1 x", "{what}");
        assert_eq!(loaded.left_aside.len(), 1, "{what}");
        assert!(loaded.left_aside[0].to_string().starts_with("2 groups: "), "{}", loaded.left_aside[0]);
        let (names, of_facet) = read(&named("g"));
        assert_eq!(names, ["1 group0", "2 group1"], "{what}");
        assert_eq!(of_facet, rows.iter().map(|row| row / 3).collect::<Vec<_>>(), "{what}");
        let error = decode_with_regions(Format::Obj, text.as_bytes(), &named("o")).unwrap_err();
        assert!(error.to_string().ends_with("there is \"usemtl\", \"g\""), "{error}");
        let ignored = decode_with_regions(Format::Obj, text.as_bytes(), &RegionChoice::Ignore).unwrap();
        assert_eq!(ignored.left_aside.len(), 2, "{what}");
    }
}

/// A solid of each name: a triangle at its own height.
fn solids_of(names: &[&str]) -> String {
    let solid = |(k, name): (usize, &&str)| {
        format!(
            "SOLID {name}\nfacet normal 0 0 1\nouter loop\nvertex 0 0 {k}\nvertex 1 0 {k}\nvertex 0 1 {k}\nendloop\nendfacet\nendsolid {name}\n"
        )
    };
    names.iter().enumerate().map(solid).collect()
}

#[test]
fn solids_of_one_name_are_one_region() {
    let text = solids_of(&["Part A", "", "b", "Part A", ""]);
    let loaded = decode_with_attributes(Format::Stl, text.as_bytes()).unwrap();
    let regions = loaded.attributes.regions().unwrap();
    assert_eq!(regions.of_facet(), [0, 1, 2, 0, 3]);
    let labels: Vec<String> = (0..4).map(|k| regions.label(k)).collect();
    assert_eq!(labels, ["Part A", "2", "b", "4"]);
    // Two bytes of each facet of a binary file.
    let mut bytes = encode(Format::Stl, &Shape::Torus.build(300)).unwrap();
    let facets = (bytes.len() - 84) / 50;
    for facet in 0..facets / 2 {
        bytes[84 + 50 * facet + 48..][..2].copy_from_slice(&0x801fu16.to_le_bytes());
    }
    let loaded = decode_with_attributes(Format::Stl, &bytes).unwrap();
    let numbers: Vec<i64> = loaded.attributes.regions().unwrap().all().iter().map(|region| region.number).collect();
    assert_eq!(numbers, [0, 0x801f]);
}

#[test]
fn groups_of_gmsh_4_are_those_of_its_surfaces() {
    let text = "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$PhysicalNames\n2\n2 5 \"skin\"\n3 5 \"all\"\n$EndPhysicalNames\n\
                $Entities\n1 1 3 0\n1 0 0 0 0\n1 0 0 0 1 1 1 0 2 1 -1\n1 0 0 0 1 1 1 1 5 1 1\n2 0 0 0 1 1 1 2 -6 5 1 1\n3 0 0 0 1 1 1 0 0\n\
                $EndEntities\n$Nodes\n1 4 1 4\n2 1 0 4\n1\n2\n3\n4\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n$EndNodes\n\
                $Elements\n3 4 1 4\n2 1 2 2\n1 1 2 3\n2 1 2 4\n2 2 2 1\n3 2 3 4\n2 3 2 1\n4 1 3 4\n$EndElements\n";
    let loaded = decode_with_attributes(Format::Gmsh, text.as_bytes()).unwrap();
    let regions = loaded.attributes.regions().unwrap();
    let read: Vec<(i64, &str)> =
        regions.of_facet().iter().map(|&k| &regions.all()[k as usize]).map(|r| (r.number, r.name.as_str())).collect();
    assert_eq!(read, [(5, "skin"), (5, "skin"), (6, ""), (0, "")]);
    assert_eq!(loaded.left_aside, []);
    // Without groups they are the surfaces, and what cannot be read of names refuses nothing.
    let begin = text.find("1 1 3 0").unwrap();
    let broken = format!("{}x{}", &text[..begin], &text[begin..]);
    let loaded = decode_with_attributes(Format::Gmsh, broken.as_bytes()).unwrap();
    let numbers: Vec<i64> = loaded.attributes.regions().unwrap().numbers().collect();
    assert_eq!((numbers, loaded.left_aside.len()), (vec![1, 1, 2, 3], 1));
}

#[test]
fn data_are_no_regions() {
    let n = 12;
    let ply = |label: &dyn Fn(usize) -> String| {
        let mut k = 0;
        let (points, faces) = rows(n, |_, quad| {
            k += 1;
            format!("4 {} {}\n", corners(quad, 0), label(k - 1))
        });
        let count = points.lines().count();
        format!(
            "ply\nformat ascii 1.0\nelement vertex {count}\nproperty float x\nproperty float y\nproperty float z\nelement face {}\nproperty list uchar int vertex_indices\nproperty double part\nend_header\n{points}{faces}",
            n * n
        )
    };
    let reason = |text: &str| {
        let loaded = decode_with_regions(Format::Ply, text.as_bytes(), &named("part")).unwrap();
        assert_eq!(loaded.attributes.regions(), None);
        loaded.left_aside.iter().map(|error| error.to_string()).collect::<Vec<_>>().join("; ")
    };
    let halves = reason(&ply(&|k| format!("{}", k as f64 / 2.0)));
    assert!(halves.contains("0.5 is no whole number"), "{halves}");
    let data = reason(&ply(&|k| (k * 7919 % 100).to_string()));
    assert!(data.contains("as data do"), "{data}");
    let gap = reason(&ply(&|k| if k == 3 { "nan".to_owned() } else { "1".to_owned() }));
    assert!(gap.contains("NaN"), "{gap}");
    let error =
        decode_with_regions(Format::Off, b"OFF 3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", &named("part")).unwrap_err();
    assert_eq!(error.to_string(), "there is no array \"part\" of facets to make regions of; there is none");

    // More labels than there may be regions.
    let mut obj = String::from("v 0 0 0\nv 1 0 0\nv 0 1 0\n");
    (0..=MAX_REGIONS).for_each(|k| _ = writeln!(obj, "usemtl m{k}\nf 1 2 3"));
    let loaded = decode_with_attributes(Format::Obj, obj.as_bytes()).unwrap();
    assert!(loaded.left_aside[0].to_string().contains("more than 65536"), "{:?}", loaded.left_aside);
}

#[test]
fn names_become_what_regions_have() {
    assert_eq!(name(b"  a\tb \r"), "a b");
    assert_eq!(name("é".repeat(100).as_bytes()), "é".repeat(64));
    assert_eq!(name(b"\xff\x00"), "\u{fffd}");
    assert_eq!(name(b"\x01"), "");
}

#[test]
fn whatever_is_cut_off_or_flipped_is_read_or_refused() {
    let mesh = Shape::Torus.build(16);
    let regions = slabs(&mesh, &[3, 5, 6], 1);
    let mut files: Vec<(Format, Vec<u8>)> = Format::ALL
        .into_iter()
        .map(|format| (format, encode_with_attributes(format, &mesh, &with_regions(&mesh, &regions)).unwrap().0))
        .collect();
    files.push((Format::Stl, solids_of(&["a", "", "b"]).into_bytes()));
    for (format, file) in files {
        let check = |bytes: &[u8]| {
            let plain = decode(format, bytes);
            for choice in [RegionChoice::Named, RegionChoice::Ignore, named("regions")] {
                let read = decode_with_regions(format, bytes, &choice);
                match (&plain, &read) {
                    (Ok(mesh), Ok(loaded)) => assert_eq!(*mesh, loaded.mesh, "{format:?}"),
                    (Ok(_), Err(error)) => {
                        assert!(
                            matches!(error, DataError::NoRegions { .. }) && choice.array().is_some(),
                            "{format:?} {error}"
                        );
                    }
                    (Err(_), read) => assert!(read.is_err(), "{format:?}"),
                }
            }
        };
        // A prime, so that all kinds of places are tried.
        let step = if file.len() > 2000 { 7 } else { 3 };
        for end in (0..=file.len()).step_by(step) {
            check(&file[..end]);
        }
        for at in (0..file.len()).step_by(step) {
            let mut other = file.clone();
            other[at] ^= [1, 0x10, 0x80][at / step % 3];
            check(&other);
        }
    }
}
