//! Formats of surfaces as HTTP names them.
//!
//! Purpose: the format of a media type, of a name, and of bytes that nobody named; and back. Invariant: a match names every
//! format, so that a new one does not compile until it is here. Must not know: what is in a file beyond its first line.

use geometry::mesh::io::{self, Format};
use jobs::record::MeshFormat;

/// All formats.
fn all() -> impl Iterator<Item = MeshFormat> {
    Format::ALL.into_iter().map(MeshFormat::from)
}

/// The media type of a format, and others that mean it. Those of OBJ, STL and glTF are registered.
fn types(format: MeshFormat) -> &'static [&'static str] {
    match format {
        MeshFormat::Ply => &["application/x-ply", "model/ply", "model/x-ply", "application/ply"],
        MeshFormat::Obj => &["model/obj", "application/x-obj", "model/x-obj"],
        MeshFormat::Stl => {
            &["model/stl", "model/x.stl-binary", "model/x.stl-ascii", "application/sla", "application/vnd.ms-pki.stl"]
        }
        MeshFormat::Off => &["application/x-off", "model/off", "model/x-off"],
        MeshFormat::Vtk => &["application/x-vtk", "model/vtk", "model/x-vtk"],
        MeshFormat::Vtp => &["application/x-vtp", "model/vtp", "model/x-vtp"],
        MeshFormat::Msh => &["application/x-gmsh", "model/gmsh", "model/x-gmsh"],
        MeshFormat::Mesh => &["application/x-medit", "model/medit", "model/x-medit"],
        MeshFormat::Meshb => &["application/x-medit-binary", "model/x-medit-binary"],
        MeshFormat::Glb => &["model/gltf-binary"],
        MeshFormat::Gltf => &["model/gltf+json"],
    }
}

/// What the query calls a format.
pub(super) fn name(format: MeshFormat) -> &'static str {
    Format::from(format).extension()
}

/// The media type of a format.
pub(super) fn media_type(format: MeshFormat) -> &'static str {
    types(format).first().copied().unwrap_or("application/octet-stream")
}

/// The format of a name.
pub(super) fn of_name(text: &str) -> Option<MeshFormat> {
    all().find(|format| name(*format).eq_ignore_ascii_case(text))
}

/// All names, for who gave another.
pub(super) fn names() -> String {
    all().map(name).collect::<Vec<_>>().join(", ")
}

/// The format that the first of these media types means, if one does.
pub(super) fn of_types(header: &str) -> Option<MeshFormat> {
    header.split(',').find_map(|one| {
        let media = one.split(';').next().unwrap_or_default().trim();
        all().find(|format| types(*format).iter().any(|known| known.eq_ignore_ascii_case(media)))
    })
}

/// The format of a file, by its bytes; of a packed one, by what is packed.
pub(super) fn sniffed(bytes: &[u8]) -> Option<MeshFormat> {
    match (io::are_packed(bytes), bytes.last_chunk()) {
        // The last four bytes are the length of what is packed, as far as 32 bits hold it.
        (true, Some(length)) => {
            let length = u32::from_le_bytes(*length);
            of_head(&io::unpack_head(bytes, HEAD_BYTES), |expected| expected as u32 == length)
        }
        _ => of_head(&bytes[..bytes.len().min(HEAD_BYTES)], |expected| expected == bytes.len() as u64),
    }
}

/// As much of a file as says what it is.
const HEAD_BYTES: usize = 64 << 10;

/// The format of a file that begins so, and of which is known whether it has so many bytes.
fn of_head(bytes: &[u8], is_length: impl Fn(u64) -> bool) -> Option<MeshFormat> {
    /// Header of a binary STL and its count, and a facet.
    const HEAD: u64 = 84;
    const FACET: u64 = 50;
    if bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r") {
        return Some(MeshFormat::Ply);
    }
    if bytes.starts_with(b"glTF") {
        return Some(MeshFormat::Glb);
    }
    let count = bytes.get(80..84).and_then(|count| Some(u64::from(u32::from_le_bytes(count.try_into().ok()?))));
    if count.is_some_and(|count| is_length(HEAD + FACET * count)) {
        return Some(MeshFormat::Stl);
    }
    // A 1 in either byte order, and a version of 1 to 4.
    if let Some(&([1, 0, 0, 0, 1..=4, 0, 0, 0] | [0, 0, 0, 1, 0, 0, 0, 1..=4])) = bytes.first_chunk() {
        return Some(MeshFormat::Meshb);
    }
    let head = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    if head.starts_with(b"# vtk DataFile") {
        return Some(MeshFormat::Vtk);
    }
    let text = head.trim_ascii_start();
    if text.starts_with(b"{") {
        return is_within(text, b"\"asset\"").then_some(MeshFormat::Gltf);
    }
    if text.starts_with(b"<") {
        return is_within(text, b"<VTKFile").then_some(MeshFormat::Vtp);
    }
    let mut lines = head.split(|byte| *byte == b'\n').map(|line| line.trim_ascii());
    let first = lines.find(|line| !line.is_empty() && !line.starts_with(b"#"))?;
    match first.split(u8::is_ascii_whitespace).next()? {
        b"solid" => Some(MeshFormat::Stl),
        b"OFF" | b"COFF" | b"NOFF" | b"CNOFF" | b"STOFF" => Some(MeshFormat::Off),
        b"v" | b"vn" | b"vt" | b"f" | b"o" | b"g" | b"s" | b"usemtl" | b"mtllib" => Some(MeshFormat::Obj),
        b"$MeshFormat" => Some(MeshFormat::Msh),
        word if word.eq_ignore_ascii_case(b"MeshVersionFormatted") => Some(MeshFormat::Mesh),
        _ => None,
    }
}

fn is_within(text: &[u8], word: &[u8]) -> bool {
    text.windows(word.len()).any(|window| window == word)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_format_has_a_type_and_a_name_of_its_own() {
        for format in all() {
            assert_eq!(of_types(media_type(format)), Some(format));
            assert_eq!(of_name(name(format)), Some(format));
        }
        assert_eq!(of_types("text/html, model/obj;q=0.9"), Some(MeshFormat::Obj));
        assert_eq!(of_types("*/*"), None);
    }

    #[test]
    fn files_say_what_they_are() {
        let mut stl = vec![0; 84];
        stl[80] = 1;
        stl.resize(134, 7);
        for (bytes, format) in [
            (&b"ply\nformat ascii 1.0\n"[..], Some(MeshFormat::Ply)),
            (b"# made by hand\n\nv 0 0 0\n", Some(MeshFormat::Obj)),
            (b"mtllib a.mtl\r\nv 0 0 0\n", Some(MeshFormat::Obj)),
            (b"solid cube\n", Some(MeshFormat::Stl)),
            (&stl, Some(MeshFormat::Stl)),
            (b"OFF\n3 1 0\n", Some(MeshFormat::Off)),
            (b"# vtk DataFile Version 3.0\n", Some(MeshFormat::Vtk)),
            (b"<?xml version=\"1.0\"?>\n<VTKFile type=\"PolyData\">", Some(MeshFormat::Vtp)),
            (b"$MeshFormat\n4.1 0 8\n", Some(MeshFormat::Msh)),
            (b"\xef\xbb\xbf# made by hand\nMeshVersionFormatted 2\n", Some(MeshFormat::Mesh)),
            (b"\x01\0\0\0\x02\0\0\0\x03\0\0\0", Some(MeshFormat::Meshb)),
            (b"glTF\x02\0\0\0", Some(MeshFormat::Glb)),
            (b"{ \"asset\": {} }", Some(MeshFormat::Gltf)),
            (b"<svg>", None),
            (b"{}", None),
            (b"", None),
        ] {
            assert_eq!(sniffed(bytes), format);
        }
    }

    /// What the library writes needs no word.
    #[test]
    fn our_own_files_say_what_they_are() {
        let mesh = geometry::mesh::shapes::Shape::Torus.build(200);
        for format in Format::ALL {
            let bytes = io::encode(format, &mesh).unwrap();
            assert_eq!(sniffed(&bytes), Some(format.into()));
            let packed = io::pack_for(std::path::Path::new("a.gz"), bytes).unwrap();
            assert_eq!(sniffed(&packed), Some(format.into()));
            assert_eq!(sniffed(&packed[..20]), None);
        }
    }
}
