//! The format of a file, by its first bytes.
//!
//! Purpose: [`recognize`], by the [`Signature`] of each format. Invariant: words are compared only where no start fits, since the
//! header of a binary STL may begin with any word. Must not know: how a format begins.

use super::{Format, packed, without_mark};

/// How the files of a format begin.
pub(super) enum Signature {
    /// The function recognizes the start.
    Start(fn(&Head<'_>) -> bool),
    /// The first word is one of these, after empty lines and lines that begin with `#`.
    Words(&'static [&'static str]),
}

/// The first bytes of a file, and its length.
pub(super) struct Head<'a> {
    pub(super) bytes: &'a [u8],
    length: u64,
    /// The bits of the length that are known: of a packed file the lower 32.
    known: u64,
}

impl<'a> Head<'a> {
    /// Whether the file is of this length, in bytes.
    pub(super) fn has_length(&self, expected: u64) -> bool {
        (self.length ^ expected) & self.known == 0
    }

    /// The bytes without a byte order mark.
    pub(super) fn text(&self) -> &'a [u8] {
        without_mark(self.bytes)
    }

    /// The first word, after empty lines and lines that begin with `#`.
    pub(super) fn word(&self) -> &'a [u8] {
        let mut lines = self.text().split(|byte| *byte == b'\n').map(<[u8]>::trim_ascii);
        let first = lines.find(|line| !line.is_empty() && !line.starts_with(b"#")).unwrap_or_default();
        first.split(u8::is_ascii_whitespace).next().unwrap_or_default()
    }

    /// Whether the text begins with this character and has this name in it.
    pub(super) fn is_document(&self, first: u8, name: &[u8]) -> bool {
        let text = self.text().trim_ascii_start();
        text.first() == Some(&first) && text.windows(name.len()).any(|window| window == name)
    }
}

/// Bytes of a file that are looked at.
const HEAD_BYTES: usize = 64 << 10;

/// The format of a file; of a packed one, by the file inside.
pub(super) fn recognize(bytes: &[u8]) -> Option<Format> {
    let unpacked;
    let head = match (packed::are_packed(bytes), bytes.last_chunk()) {
        (true, Some(length)) => {
            unpacked = packed::unpack_head(bytes, HEAD_BYTES);
            Head { bytes: &unpacked, length: u32::from_le_bytes(*length).into(), known: u32::MAX.into() }
        }
        _ => Head { bytes: &bytes[..bytes.len().min(HEAD_BYTES)], length: bytes.len() as u64, known: u64::MAX },
    };
    let starts = |format: &Format| matches!(format.codec().signature, Signature::Start(fits) if fits(&head));
    let word = head.word();
    let says = |format: &Format| match format.codec().signature {
        Signature::Words(words) => words.iter().any(|known| known.as_bytes() == word),
        Signature::Start(_) => false,
    };
    Format::ALL.into_iter().find(starts).or_else(|| Format::ALL.into_iter().find(says))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::io::{encode, pack_for};

    #[test]
    fn files_say_what_they_are() {
        let mut stl = vec![0; 84];
        stl[80] = 1;
        stl.resize(134, 7);
        let mut other = stl.clone();
        other[..4].copy_from_slice(b"OFF ");
        for (bytes, format) in [
            (&b"ply\nformat ascii 1.0\n"[..], Some(Format::Ply)),
            (b"# made by hand\n\nv 0 0 0\n", Some(Format::Obj)),
            (b"mtllib a.mtl\r\nv 0 0 0\n", Some(Format::Obj)),
            (b"solid cube\n", Some(Format::Stl)),
            (&stl, Some(Format::Stl)),
            (b"OFF\n3 1 0\n", Some(Format::Off)),
            (b"# vtk DataFile Version 3.0\n", Some(Format::Vtk)),
            // Its title may be a word of another format.
            (b"# vtk DataFile Version 3.0\nsolid part\nASCII\n", Some(Format::Vtk)),
            (b"<?xml version=\"1.0\"?>\n<VTKFile type=\"PolyData\">", Some(Format::Vtp)),
            (b"$MeshFormat\n4.1 0 8\n", Some(Format::Gmsh)),
            (b"\xef\xbb\xbf# made by hand\nMeshVersionFormatted 2\n", Some(Format::Medit)),
            (b"\x01\0\0\0\x02\0\0\0\x03\0\0\0", Some(Format::MeditBinary)),
            (b"glTF\x02\0\0\0", Some(Format::Glb)),
            (b"{ \"asset\": {} }", Some(Format::Gltf)),
            // A header of a binary STL may begin with a word of another format.
            (&other, Some(Format::Stl)),
            (b"<svg>", None),
            (b"{}", None),
            (b"", None),
        ] {
            assert_eq!(recognize(bytes), format);
        }
    }

    /// Files that the library writes are recognized.
    #[test]
    fn our_own_files_say_what_they_are() {
        let mesh = crate::mesh::shapes::Shape::Torus.build(200);
        for format in Format::ALL {
            let bytes = encode(format, &mesh).unwrap();
            assert_eq!(recognize(&bytes), Some(format));
            let packed = pack_for(std::path::Path::new("a.gz"), bytes).unwrap();
            assert_eq!(recognize(&packed), Some(format));
            assert_eq!(recognize(&packed[..20]), None);
        }
    }
}
