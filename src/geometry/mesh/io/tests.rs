//! Counting what a file holds gives what reading it gives, or more.

use super::*;
use crate::mesh::shapes::Shape;

const PLY: &str = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n\
                   element face 2\nproperty list uchar float st\nproperty list uchar int vertex_indices\nend_header\n\
                   0 0 0\n1 0 0\n1 1 0\n0 1 0\n2 2\n1\n0 4 0 1 2 3\n2 .5 .5 3 1 4 2\n";
const OFF: &str = "OFF # a comment\n5 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n\n2 2 1\n4 0 1 2 3 255 0 0\n3 1 4 2\n";
const OBJ: &str =
    "v 0 0 0\nv 1 0 0\nv 1 1 0\nvt 1 1\nv 0 1 0\nv 2 2 1\nl 1 2 3\nf 1/1 2/1 \\\n3/1 4/1 # f 1 2 3\nf 2 5 3\n";
const STL: &str = "solid a\nFacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n\
                   endsolid a\nsolid b\nfacet normal 0 0 1\nouter loop\nvertex 0 0 1\nvertex 1 0 1\nvertex 0 1 1\n\
                   endloop\nendfacet\nendsolid b\n";

/// Files of all formats with polygons, attributes, comments and several solids.
const TEXTS: [(Format, &str); 4] = [(Format::Ply, PLY), (Format::Off, OFF), (Format::Obj, OBJ), (Format::Stl, STL)];

fn found(format: Format, bytes: &[u8]) -> Option<(u64, u64)> {
    let mesh = decode(format, bytes).ok()?;
    Some((mesh.positions().len() as u64, mesh.facets().len() as u64))
}

#[test]
fn a_ply_header_has_an_end() {
    let property = |n: usize| (0..n).map(|i| format!("property float p{i}\n")).collect::<String>();
    let element = |n: usize| (0..n).map(|i| format!("element e{i} 0\n")).collect::<String>();
    for names in
        [element(5000), element(1) + &property(5000), "element x 0\nproperty int a\n".to_owned() + &element(4999)]
    {
        let text = format!("ply\nformat ascii 1.0\n{names}end_header\n");
        let error = decode(Format::Ply, text.as_bytes()).unwrap_err();
        assert!(error.to_string().contains("more than 4096 elements and properties"), "{error}");
    }
}

#[test]
fn surfaces_that_were_written_are_counted_exactly() {
    for shape in Shape::ALL {
        let mesh = shape.build(700);
        let (vertices, facets) = (mesh.positions().len() as u64, mesh.facets().len() as u64);
        for format in Format::ALL {
            let Ok(bytes) = encode(format, &mesh) else { continue };
            let wanted = if format == Format::Stl { 3 * facets } else { vertices };
            assert_eq!(counts(format, &bytes), Some((wanted, facets)), "{shape:?} as {format:?}");
        }
    }
}

#[test]
fn polygons_count_as_their_triangles_and_attributes_for_nothing() {
    for (format, text) in TEXTS {
        let read = found(format, text.as_bytes()).unwrap();
        let (vertices, facets) = counts(format, text.as_bytes()).unwrap();
        assert_eq!(facets, read.1, "{format:?}");
        assert!(vertices >= read.0, "{format:?}");
        let marked = [b"\xef\xbb\xbf", text.as_bytes()].concat();
        assert_eq!(counts(format, &marked), Some((vertices, facets)), "{format:?}");
    }
}

#[test]
fn binary_rows_are_passed_over_in_both_orders() {
    for (order, big) in [("binary_little_endian", false), ("binary_big_endian", true)] {
        let mut file = format!(
            "ply\nformat {order} 1.0\nelement vertex 4\nproperty double x\nproperty float y\nproperty float z\n\
             element face 2\nproperty list ushort uchar flags\nproperty uchar part\n\
             property list uint int vertex_indices\nend_header\n"
        )
        .into_bytes();
        let mut word = |bytes: &[u8]| match big {
            true => file.extend(bytes),
            false => file.extend(bytes.iter().rev()),
        };
        for corner in [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0f32]] {
            word(&f64::from(corner[0]).to_be_bytes());
            word(&corner[1].to_be_bytes());
            word(&0f32.to_be_bytes());
        }
        for (flags, corners) in [(3u16, &[0u32, 1, 2, 3][..]), (0, &[0, 2, 1])] {
            word(&flags.to_be_bytes());
            (0..=flags).for_each(|_| word(&[7]));
            word(&(corners.len() as u32).to_be_bytes());
            corners.iter().for_each(|corner| word(&corner.to_be_bytes()));
        }
        assert_eq!(found(Format::Ply, &file), Some((4, 3)), "{order}");
        assert_eq!(counts(Format::Ply, &file), Some((4, 3)), "{order}");
    }
}

#[test]
fn a_header_that_lies_is_nothing_and_not_believed() {
    let lies: [(Format, &[u8]); 8] = [
        (Format::Ply, b"ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n0\n"),
        (Format::Ply, b""),
        (Format::Off, b"OFF\n18446744073709551615 18446744073709551615 0\n0 0 0\n"),
        (Format::Off, b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n99999999999999999999 0 1 2\n"),
        (Format::Off, b"OFF BINARY\n"),
        (Format::Stl, &[0xff; 200]),
        (Format::Stl, b"solid nothing\nendsolid\n"),
        (Format::Obj, b"f 1 2 3\n"),
    ];
    for (format, bytes) in lies {
        assert_eq!(counts(format, bytes), None, "{format:?} {}", String::from_utf8_lossy(bytes));
    }
    // A face that says it has more corners than there is room for.
    let off = b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n18446744073709551615 0 1 2\n";
    assert!(counts(Format::Off, off).is_none_or(|(_, facets)| facets < 20));
    let negative = PLY.replace("4 0 1 2 3", "-4 0 1 2 3");
    assert_eq!(counts(Format::Ply, negative.as_bytes()), None);
}

#[test]
fn whatever_is_cut_off_or_flipped_counts_no_more_than_its_bytes_can_hold() {
    let torus = Shape::Torus.build(16);
    let mut files: Vec<(Format, Vec<u8>)> =
        TEXTS.iter().map(|&(format, text)| (format, text.as_bytes().to_vec())).collect();
    files.extend(Format::ALL.iter().filter_map(|&format| Some((format, encode(format, &torus).ok()?))));
    for (format, file) in files {
        let check = |bytes: &[u8]| {
            let read = found(format, bytes);
            let Some((vertices, facets)) = counts(format, bytes) else {
                assert_eq!(read, None, "{format:?} {}", String::from_utf8_lossy(bytes));
                return;
            };
            // Three vertices for a facet of STL; an OBJ face takes two bytes a corner.
            assert!(vertices <= bytes.len() as u64 && facets <= bytes.len() as u64, "{format:?}");
            assert!(read.is_none_or(|(v, f)| v <= vertices && f <= facets), "{format:?}");
        };
        for end in 0..=file.len() {
            check(&file[..end]);
        }
        for at in 0..file.len() {
            let mut other = file.clone();
            other[at] ^= [1, 0x10, 0x80][at % 3];
            check(&other);
        }
    }
}
