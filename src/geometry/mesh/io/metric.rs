//! Metric tensors in files, one for each vertex of a surface in another file.
//!
//! Purpose: [`read`] takes Medit's `.sol` and `.solb`, arrays of points in VTK files, NumPy's `.npy`, and lines of text with six
//! numbers. All become [`Tensor`]s. Invariant: as for surfaces, no bytes make a reader panic or take more memory than a small
//! multiple of theirs. A tensor of two dimensions has its larger eigenvalue across the plane z = 0.
//! Must not know: whether tensors are metrics, which surface they are for.

use super::numbers::{Cursor, Encoding, Kind, Order, shown};
use super::{DataError, Format, decode_with_attributes, lists, unpack, unpacked_limit, without_mark};
use crate::mesh::tensor::Tensor;
use crate::token::Token;

/// The tensors of a file with this name, in its order.
pub fn read(name: &str, bytes: &[u8], token: &Token) -> Result<Vec<Tensor>, DataError> {
    let name = name.to_ascii_lowercase();
    let stem = name.strip_suffix(".gz").unwrap_or(&name);
    let extension = stem.rsplit_once('.').map_or("", |(_, extension)| extension);
    if matches!(extension, "vtk" | "vtp" | "vtu") {
        return of_vtk(Format::from_extension(extension).unwrap_or(Format::Vtk), bytes);
    }
    let plain = unpack(bytes, unpacked_limit(bytes.len()))?;
    let plain = without_mark(&plain);
    match extension {
        "sol" => Solution::text(plain),
        "solb" => Solution::binary(plain),
        "npy" => of_numpy(plain),
        _ => {
            let wrong = || DataError::Header(format!("the name does not end in {FILES}, and it is no text"));
            lists::tensors(std::str::from_utf8(plain).map_err(|_| wrong())?, usize::MAX, token)
        }
    }
}

/// Extensions that [`read`] knows, for a sentence.
pub const FILES: &str = ".sol, .solb, .vtk, .vtp, .vtu or .npy";

/// Of the plane z = 0: m11, m12, m22.
fn of_plane([xx, xy, yy]: [f64; 3]) -> Tensor {
    let larger = 0.5 * (xx + yy) + (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
    Tensor([xx, xy, yy, 0.0, 0.0, larger])
}

/// A full matrix, row by row.
fn of_matrix(m: &[f64]) -> Tensor {
    Tensor([m[0], 0.5 * (m[1] + m[3]), m[4], 0.5 * (m[2] + m[6]), 0.5 * (m[5] + m[7]), m[8]])
}

/// The one array of 6 or 9 numbers a point, or that which is called "metric".
fn of_vtk(format: Format, bytes: &[u8]) -> Result<Vec<Tensor>, DataError> {
    let loaded = decode_with_attributes(format, bytes)?;
    let arrays: Vec<_> = loaded.attributes.scalars().iter().filter(|array| matches!(array.components, 6 | 9)).collect();
    let array = match arrays[..] {
        [] => {
            let aside: Vec<String> = loaded.left_aside.iter().map(ToString::to_string).collect();
            let aside = if aside.is_empty() { String::new() } else { format!(" ({})", aside.join("; ")) };
            let text = "no array of the points has 6 or 9 numbers a point; write the metric as one";
            return Err(DataError::List(format!("{text}{aside}")));
        }
        [array] => array,
        _ => {
            let named = arrays.iter().find(|array| array.name.eq_ignore_ascii_case("metric"));
            let names: Vec<&str> = arrays.iter().map(|array| array.name.as_str()).collect();
            let text =
                || format!("the arrays {} have 6 or 9 numbers a point; call one of them metric", names.join(", "));
            named.copied().ok_or_else(|| DataError::List(text()))?
        }
    };
    // VTK has the diagonal first: XX, YY, ZZ, XY, YZ, XZ.
    let of_six = |m: &[f64]| Tensor([m[0], m[3], m[1], m[5], m[4], m[2]]);
    let values = array.values.chunks_exact(array.components);
    Ok(if array.components == 6 { values.map(of_six).collect() } else { values.map(of_matrix).collect() })
}

/// A Medit solution: the dimension, and numbers of the vertices.
#[derive(Default)]
struct Solution {
    dimension: usize,
    tensors: Option<Vec<Tensor>>,
}

/// Keywords in binary files.
const DIMENSION: i64 = 3;
const END: i64 = 54;
const AT_VERTICES: i64 = 62;
/// A kind of solution: a symmetric tensor.
const TENSOR: i64 = 3;

impl Solution {
    fn text(bytes: &[u8]) -> Result<Vec<Tensor>, DataError> {
        let mut cursor = Cursor::new(bytes);
        cursor.has_comments = true;
        let word = cursor.word().ok_or(DataError::Empty)?;
        if !word.eq_ignore_ascii_case(b"MeshVersionFormatted") {
            return Err(cursor.syntax(format!("\"{}\" is not MeshVersionFormatted", shown(word))));
        }
        cursor.integer(Kind::I32, "a version")?;
        let mut solution = Self { dimension: 3, tensors: None };
        while let Some(word) = cursor.word() {
            match word.to_ascii_lowercase().as_slice() {
                b"dimension" => solution.keyword(DIMENSION, &mut cursor, (Kind::F64, Kind::I32))?,
                b"solatvertices" => solution.keyword(AT_VERTICES, &mut cursor, (Kind::F64, Kind::I32))?,
                b"end" => break,
                // Others and their numbers are passed over.
                _ => {}
            }
        }
        solution.end()
    }

    fn binary(bytes: &[u8]) -> Result<Vec<Tensor>, DataError> {
        let mut cursor = Cursor::new(bytes);
        cursor.encoding = Encoding::Binary(match bytes.first_chunk::<4>() {
            Some([1, 0, 0, 0]) => Order::Little,
            Some([0, 0, 0, 1]) => Order::Big,
            _ => return Err(DataError::Header("it does not begin with a 1 of four bytes; name text .sol".to_owned())),
        });
        cursor.take(4);
        let version = cursor.integer(Kind::I32, "keywords")?;
        if !(1..=4).contains(&version) {
            return Err(DataError::Header(format!("version {version} is not 1, 2, 3 or 4")));
        }
        let place = if version > 2 { Kind::I64 } else { Kind::I32 };
        let kinds =
            (if version == 1 { Kind::F32 } else { Kind::F64 }, if version == 4 { Kind::I64 } else { Kind::I32 });
        let mut solution = Self { dimension: 3, tensors: None };
        loop {
            let keyword = cursor.integer(Kind::I32, "keywords")?;
            let next = usize::try_from(cursor.integer(place, "keywords")?).unwrap_or(0);
            if keyword == END {
                break;
            }
            solution.keyword(keyword, &mut cursor, kinds)?;
            if next == 0 {
                break;
            }
            // Places only grow, so that this ends.
            let here = bytes.len() - cursor.rest.len();
            let wrong = || DataError::Truncated(format!("keyword {keyword} leads from byte {here} to {next}"));
            cursor.rest = bytes.get(next..).filter(|_| next >= here).ok_or_else(wrong)?;
        }
        solution.end()
    }

    fn keyword(&mut self, keyword: i64, cursor: &mut Cursor<'_>, (float, int): (Kind, Kind)) -> Result<(), DataError> {
        match keyword {
            DIMENSION => {
                self.dimension = cursor.count(Kind::I32, "a dimension")?;
                if !(2..=3).contains(&self.dimension) {
                    return Err(DataError::Header(format!("the dimension is {}, not 2 or 3", self.dimension)));
                }
            }
            AT_VERTICES => {
                let count = cursor.count(int, "a number of vertices")?;
                let kinds = cursor.count(Kind::I32, "a number of solutions")?;
                let kinds = cursor.integers(kinds, Kind::I32, "kinds of solutions")?;
                if kinds[..] != [TENSOR] {
                    let text = "are not one tensor (kind 3) a vertex; write the metric alone";
                    return Err(DataError::List(format!("its solutions at vertices, of the kinds {kinds:?}, {text}")));
                }
                let each = if self.dimension == 2 { 3 } else { Tensor::NUMBERS };
                let numbers = cursor.floats(count.saturating_mul(each), float, "tensors")?;
                self.tensors = Some(match each {
                    3 => numbers.as_chunks::<3>().0.iter().map(|&m| of_plane(m)).collect(),
                    _ => numbers.as_chunks().0.iter().map(|&m| Tensor(m)).collect(),
                });
            }
            _ => {}
        }
        Ok(())
    }

    fn end(self) -> Result<Vec<Tensor>, DataError> {
        self.tensors.ok_or_else(|| DataError::List("it has no SolAtVertices; give a metric at the vertices".to_owned()))
    }
}

/// An array (n, 6), (n, 3, 3), or (n, 3) of a plane, of float64 or float32.
fn of_numpy(bytes: &[u8]) -> Result<Vec<Tensor>, DataError> {
    let wrong = |text: String| DataError::Header(format!("{text}; save an array (n, 6) or (n, 3, 3) of float64"));
    let head = bytes.strip_prefix(b"\x93NUMPY").ok_or_else(|| wrong("it is no .npy file".to_owned()))?;
    let (length, rest) = match head {
        [1, _, a, b, rest @ ..] => (u32::from(u16::from_le_bytes([*a, *b])), rest),
        [2 | 3, _, a, b, c, d, rest @ ..] => (u32::from_le_bytes([*a, *b, *c, *d]), rest),
        _ => return Err(wrong("its header is cut off".to_owned())),
    };
    let (header, data) =
        rest.split_at_checked(length as usize).ok_or_else(|| wrong("its header is cut off".to_owned()))?;
    let header = String::from_utf8_lossy(header).replace([' ', '"', '\''], "");
    let field = |name: &str| header.split_once(&format!("{name}:")).map(|(_, rest)| rest);
    let descr = field("descr").and_then(|rest| rest.split(',').next()).unwrap_or_default();
    let (kind, order) = match descr {
        "<f8" => (Kind::F64, Order::Little),
        ">f8" => (Kind::F64, Order::Big),
        "<f4" => (Kind::F32, Order::Little),
        ">f4" => (Kind::F32, Order::Big),
        other => return Err(wrong(format!("its numbers are {}", super::numbers::plain(other, 20)))),
    };
    let text = field("shape").and_then(|rest| rest.strip_prefix('(')?.split_once(')')).map_or("", |(sizes, _)| sizes);
    let sizes = text.split(',').filter(|n| !n.is_empty()).take(4);
    let shape: Vec<usize> = sizes.map(|n| n.parse().unwrap_or(usize::MAX)).collect();
    let shown = || super::numbers::plain(text, 40);
    let each = match shape[..] {
        [_, 6] => 6,
        [_, 3] => 3,
        [_, 3, 3] => 9,
        _ => return Err(wrong(format!("its shape is ({})", shown()))),
    };
    let by_columns = field("fortran_order").is_some_and(|rest| rest.starts_with("True"));
    let numbers = kind.floats(data, order);
    if shape[0].checked_mul(each) != Some(numbers.len()) {
        return Err(DataError::Truncated(format!(
            "it has {} numbers, not those of its shape ({})",
            numbers.len(),
            shown()
        )));
    }
    let n = shape[0];
    // A symmetric matrix may be read by rows or by columns.
    let row = |k: usize| -> Vec<f64> {
        (0..each).map(|j| if by_columns { numbers[k + n * j] } else { numbers[each * k + j] }).collect()
    };
    Ok((0..n)
        .map(|k| match row(k)[..] {
            [xx, xy, yy] => of_plane([xx, xy, yy]),
            [a, b, c, d, e, f] => Tensor([a, b, c, d, e, f]),
            ref matrix => of_matrix(matrix),
        })
        .collect())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    const SIX: [f64; 6] = [4.0, 0.5, 9.0, -0.25, 0.125, 16.0];

    fn of(name: &str, bytes: &[u8]) -> Result<Vec<Tensor>, DataError> {
        read(name, bytes, &Token::default())
    }

    fn numpy(descr: &str, shape: &str, fortran: bool, numbers: &[f64]) -> Vec<u8> {
        let order = if fortran { "True" } else { "False" };
        let header = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}\n");
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend_from_slice(&(header.len() as u16).to_le_bytes());
        bytes.extend_from_slice(header.as_bytes());
        for &x in numbers {
            match descr {
                "<f8" => bytes.extend_from_slice(&x.to_le_bytes()),
                ">f8" => bytes.extend_from_slice(&x.to_be_bytes()),
                _ => bytes.extend_from_slice(&(x as f32).to_le_bytes()),
            }
        }
        bytes
    }

    fn matrix() -> [f64; 9] {
        let [xx, xy, yy, xz, yz, zz] = SIX;
        [xx, xy, xz, xy, yy, yz, xz, yz, zz]
    }

    #[test]
    fn medit_solutions_are_read() {
        let numbers = SIX.map(|m| m.to_string()).join(" ");
        let text = format!(
            "MeshVersionFormatted 2\nDimension 3 # comment\n\nSolAtVertices\n2\n1 3\n{numbers}\n{numbers}\nEnd\n"
        );
        assert_eq!(of("a.sol", text.as_bytes()).unwrap(), [Tensor(SIX); 2]);
        let plane = "MeshVersionFormatted 1\nDimension\n2\nSolAtVertices\n1\n1 3\n4 0 9\nEnd\n";
        assert_eq!(of("a.sol", plane.as_bytes()).unwrap(), [Tensor([4.0, 0.0, 9.0, 0.0, 0.0, 9.0])]);
        let mut binary = [1i32, 2, 3, 20, 3, 62, 0, 1, 1, 3].map(i32::to_le_bytes).concat();
        SIX.iter().for_each(|m| binary.extend_from_slice(&m.to_le_bytes()));
        let end = binary.len() as i32;
        binary[24..28].copy_from_slice(&end.to_le_bytes());
        binary.extend_from_slice(&[54i32, 0].map(i32::to_le_bytes).concat());
        assert_eq!(of("a.solb", &binary).unwrap(), [Tensor(SIX)]);
        for (text, wrong) in [
            ("MeshVersionFormatted 2\nDimension 3\nSolAtVertices\n2\n1 1\n1\n2\n", "kinds"),
            ("MeshVersionFormatted 2\nDimension 3\nSolAtVertices\n2\n1 3\n1 2 3\n", "cut off"),
            ("MeshVersionFormatted 2\nDimension 3\nSolAtVertices\n99999999999\n1 3\n1 2 3\n", "declared"),
            ("MeshVersionFormatted 2\nDimension 3\nEnd\n", "no SolAtVertices"),
            ("v 1 2 3\n", "not MeshVersionFormatted"),
        ] {
            let error = of("a.sol", text.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(wrong), "{text}: {error}");
        }
    }

    #[test]
    fn numpy_arrays_are_read() {
        for descr in ["<f8", ">f8", "<f4"] {
            assert_eq!(of("a.npy", &numpy(descr, "(1, 6)", false, &SIX)).unwrap(), [Tensor(SIX)], "{descr}");
            assert_eq!(of("a.npy", &numpy(descr, "(1, 3, 3)", false, &matrix())).unwrap(), [Tensor(SIX)], "{descr}");
        }
        let two: Vec<f64> = SIX.iter().flat_map(|&m| [m, 2.0 * m]).collect();
        assert_eq!(of("a.npy", &numpy("<f8", "(2, 6)", true, &two)).unwrap()[1], Tensor(SIX) * 2.0);
        let plane = numpy("<f8", "(1, 3)", false, &[4.0, 0.0, 1.0]);
        assert_eq!(of("a.npy", &plane).unwrap(), [Tensor([4.0, 0.0, 1.0, 0.0, 0.0, 4.0])]);
        for (bytes, wrong) in [
            (numpy("<i8", "(1, 6)", false, &SIX), "<i8"),
            (numpy("<f8", "(6,)", false, &SIX), "shape"),
            (numpy("<f8", "(2, 6)", false, &SIX), "6 numbers"),
            (numpy("<f8", "(18446744073709551615, 6)", false, &SIX), "6 numbers"),
            (b"\x93NUMPY\x01".to_vec(), "cut off"),
        ] {
            let error = of("a.npy", &bytes).unwrap_err().to_string();
            assert!(error.contains(wrong), "{error}");
        }
    }

    #[test]
    fn arrays_of_points_in_vtk_files_are_read() {
        let file = |data: &str| {
            format!(
                "# vtk DataFile Version 3.0\ntitle\nASCII\nDATASET POLYDATA\nPOINTS 3 double\n0 0 0 1 0 0 0 1 0\n\
                 POLYGONS 1 4\n3 0 1 2\nPOINT_DATA 3\n{data}"
            )
        };
        let nine = matrix().map(|m| m.to_string()).join(" ");
        let full = format!("TENSORS anything double\n{nine}\n{nine}\n{nine}\n");
        assert_eq!(of("a.vtk", file(&full).as_bytes()).unwrap(), [Tensor(SIX); 3]);
        let [xx, xy, yy, xz, yz, zz] = SIX;
        let six = [xx, yy, zz, xy, yz, xz].map(|m| m.to_string()).join(" ");
        let short =
            format!("FIELD data 2\nother 6 3 double\n{six} {six} {six}\nMetric 6 3 double\n{six} {six} {six}\n");
        assert_eq!(of("a.vtk", file(&short).as_bytes()).unwrap(), [Tensor(SIX); 3]);
        let error = of("a.vtk", file(&short.replace("Metric", "more")).as_bytes()).unwrap_err().to_string();
        assert!(error.contains("other, more"), "{error}");
        let error = of("a.vtk", file("SCALARS s double 1\nLOOKUP_TABLE default\n1 2 3\n").as_bytes()).unwrap_err();
        assert!(error.to_string().contains("6 or 9"), "{error}");
    }

    /// Files that are cut off, and files with any byte changed, are read or refused.
    #[test]
    fn no_bytes_stop_a_reader() {
        let numbers = SIX.map(|m| m.to_string()).join(" ");
        let text = format!("MeshVersionFormatted 2\nDimension 2\nSolAtVertices\n2\n1 3\n{numbers}\nEnd\n");
        let mut binary = [1i32, 1, 3, 20, 2, 62, 0, 2, 1, 3].map(i32::to_le_bytes).concat();
        SIX.iter().for_each(|m| binary.extend_from_slice(&(*m as f32).to_le_bytes()));
        let array = numpy("<f8", "(1, 3, 3)", false, &matrix());
        for (name, bytes) in [("a.sol", text.into_bytes()), ("a.solb", binary), ("a.npy", array)] {
            assert!(of(name, &bytes).is_ok_and(|all| !all.is_empty()), "{name}");
            for k in 0..bytes.len() {
                _ = of(name, &bytes[..k]);
                for byte in [0, 1, 9, b'9', b'(', 0x7f, 0xff] {
                    let mut changed = bytes.clone();
                    changed[k] = byte;
                    _ = of(name, &changed);
                }
            }
        }
    }

    #[test]
    fn lines_of_six_numbers_are_read() {
        let text = format!("# metric\n{}\n", SIX.map(|m| m.to_string()).join(" "));
        assert_eq!(of("a.txt", text.as_bytes()).unwrap(), [Tensor(SIX)]);
        assert!(of("a.txt", b"1 2 3\n").unwrap_err().to_string().contains("line 1"));
        assert!(of("a.dat", &[0xff, 0xfe, 0x80]).unwrap_err().to_string().contains(".npy"));
    }
}
