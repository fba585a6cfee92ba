//! Files of the command line: surfaces, points, lists that go by the vertices of the input (`--sizes`, `--metric`,
//! `--creases`), reports.
//!
//! Invariant: numbers are written so that reading gives the same bits. A file appears under its name only when it is
//! whole, and replaces only then what was there. `-` is the standard input or output, where a command takes it for a surface.
//! Errors of a list name the file and the line. Must not know: what lists are for.

use std::fmt;
use std::fs::{File, OpenOptions};
use std::io::{BufWriter, ErrorKind, Read, Write};
use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use glam::DVec3;
use tempfile::{NamedTempFile, TempPath};

use super::exit::{BadInput, NoFolder, NoInput, NotWritten, Usage};
use geometry::mesh::attributes::Attributes;
use geometry::mesh::io::lists::{FileVertices, NO_NUMBERS};
use geometry::mesh::io::{DataError, FileError, Format, RegionChoice};
use geometry::mesh::parts::Part;
use geometry::mesh::tensor::Tensor;
use geometry::mesh::{TriMesh, io};
use geometry::remesh::Warning;
use geometry::token::Token;

/// Where a surface is read or written: a file, or `-` for the standard input or output.
#[derive(Clone, Debug)]
pub(crate) struct Surface {
    path: PathBuf,
    /// The given format; without, the name has it.
    format: Option<Format>,
}

impl Surface {
    pub(crate) fn new(path: &Path, format: Option<Format>) -> Self {
        Self { path: path.to_owned(), format }
    }

    pub(crate) fn is_standard(&self) -> bool {
        self.path.as_os_str() == "-"
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// The format; `option` gives it where the name does not.
    pub(crate) fn format(&self, option: &str) -> Result<Format> {
        match self.format {
            Some(format) => Ok(format),
            None if self.is_standard() => {
                let names = Format::ALL.map(Format::extension).join(", ");
                Err(Usage(format!("- has no extension; add {option}, one of {names}")).into())
            }
            None => Ok(Format::of_path(&self.path)?),
        }
    }

    /// The bytes of a surface in this format, with what it names in other files.
    pub(crate) fn bytes(&self, format: Format) -> Result<Vec<u8>> {
        if !self.is_standard() {
            return io::read_bytes(&self.path, format).map_err(unread);
        }
        let mut bytes = Vec::new();
        let read = std::io::stdin().lock().read_to_end(&mut bytes);
        read.map_err(|cause| NoInput { path: self.path.clone(), cause })?;
        Ok(bytes)
    }

    pub(crate) fn read_mesh(&self) -> Result<TriMesh> {
        let format = self.format(INPUT_FORMAT)?;
        let bytes = self.bytes(format)?;
        Ok(io::decode(format, &bytes).map_err(|cause| self.refused(&cause))?)
    }

    pub(crate) fn read_loaded(&self, regions: &RegionChoice) -> Result<Loaded> {
        let format = self.format(INPUT_FORMAT)?;
        let bytes = self.bytes(format)?;
        let io::Loaded { mesh, attributes, creases, vertices, left_aside } =
            io::decode_with_regions(format, &bytes, regions).map_err(|cause| self.refused(&cause))?;
        let warnings = left_aside.iter().map(Warning::left_aside).collect();
        let attributes = Some(attributes).filter(|attributes| !attributes.is_empty());
        Ok(Loaded { mesh, attributes, creases, vertices, warnings })
    }

    fn refused(&self, cause: &DataError) -> BadInput {
        BadInput(format!("{self}: {cause}"))
    }

    /// Writes a surface and what it carries. Warns of what the format cannot hold.
    pub(crate) fn write(&self, mesh: &TriMesh, attributes: Option<&Attributes>) -> Result<Option<Warning>> {
        let format = self.format(OUTPUT_FORMAT)?;
        let none = Attributes::new(mesh);
        let encoded = io::encode_with_attributes(format, mesh, attributes.unwrap_or(&none));
        let (bytes, left_out) = encoded.map_err(|cause| self.refused(&cause))?;
        match self.is_standard() {
            true => super::say::bytes(&bytes)?,
            false => {
                let bytes = io::pack_for(&self.path, bytes).map_err(|error| unwritten(&self.path, &error))?;
                write(&self.path, |out| out.write_all(&bytes))?;
            }
        }
        Ok(Warning::not_held(&left_out))
    }

    /// Refuses an output whose format is not known or which cannot be written, before any work is done.
    pub(crate) fn check_output(&self) -> Result<()> {
        if !self.is_standard() && self.format.is_none() && Format::of_path(&self.path).is_err() {
            let text = format!("{self}: the name must end in {}; or add {OUTPUT_FORMAT}", Format::names());
            return Err(Usage(text).into());
        }
        self.format(OUTPUT_FORMAT)?;
        if self.is_standard() { Ok(()) } else { check_output(&self.path, &[]) }
    }
}

impl fmt::Display for Surface {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.path.display().fmt(f)
    }
}

pub(crate) const INPUT_FORMAT: &str = "--input-format";
pub(crate) const OUTPUT_FORMAT: &str = "--format";

/// Help for the file of a surface, with the extensions.
pub(crate) fn help_of(file: &str, more: &str) -> String {
    format!("{file}: {}; {more}", Format::names())
}

/// Reads an option: a format has the name of its extension.
pub(crate) fn format() -> impl TypedValueParser<Value = Format> {
    PossibleValuesParser::new(Format::ALL.map(Format::extension))
        .try_map(|name| Format::from_extension(&name).ok_or("is no format"))
}

pub(crate) fn read_mesh(path: &Path) -> Result<TriMesh> {
    io::read(path).map_err(unread)
}

/// A surface, what it carries, and what of that cannot be used, a line each.
pub(crate) struct Loaded {
    pub(crate) mesh: TriMesh,
    pub(crate) attributes: Option<Attributes>,
    /// Edges that the file names.
    pub(crate) creases: Vec<[u32; 2]>,
    /// Vertices that the file names.
    pub(crate) vertices: Vec<u32>,
    pub(crate) warnings: Vec<Warning>,
}

pub(crate) fn unread(error: FileError) -> anyhow::Error {
    match error {
        FileError::Io { path, cause, .. } => NoInput { path, cause }.into(),
        error => BadInput(error.to_string()).into(),
    }
}

pub(crate) fn read_text(path: &Path) -> Result<String> {
    let bytes = std::fs::read(path).map_err(|cause| NoInput { path: path.to_owned(), cause })?;
    Ok(String::from_utf8(bytes).map_err(|_| BadInput(format!("{}: this is no text in UTF-8", path.display())))?)
}

/// Refuses an output whose folder is not there or whose name is wrong, before any work is done.
pub(crate) fn check_output(path: &Path, extensions: &[&str]) -> Result<()> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    if !extensions.is_empty() && !extensions.contains(&extension.as_str()) {
        let text = format!("{}: the name must end in .{}", path.display(), extensions.join(", ."));
        return Err(Usage(text).into());
    }
    let folder = folder_of(path);
    if !folder.is_dir() {
        return Err(NoFolder { path: path.to_owned(), folder: folder.to_owned() }.into());
    }
    let cannot = |error: std::io::Error| unwritten(path, &error);
    match std::fs::metadata(path) {
        Ok(meta) if meta.is_dir() => return Err(cannot(ErrorKind::IsADirectory.into()).into()),
        // What is there stays as it is until the result is whole.
        Ok(meta) if meta.is_file() => drop(OpenOptions::new().append(true).open(path).map_err(cannot)?),
        _ => {}
    }
    if !is_stream(path) {
        drop(begin(path).map_err(cannot)?);
    }
    Ok(())
}

/// Whether a name is of a device or a pipe, which takes what comes and cannot be replaced.
fn is_stream(path: &Path) -> bool {
    // Where the standard output is a file, the name of its device leads there: `/dev/stdout`, `/proc/self/fd/1`.
    let leads_away = || path.canonicalize().is_ok_and(|place| place != path);
    ((path.starts_with("/dev") || path.starts_with("/proc")) && leads_away())
        || std::fs::metadata(path).is_ok_and(|meta| !meta.is_file())
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Refuses files in `new` that would replace one in `kept`, or each other.
pub(crate) fn check_apart<'a>(kept: impl Iterator<Item = &'a Path>, new: impl Iterator<Item = &'a Path>) -> Result<()> {
    let mut places: Vec<_> = kept.map(place).collect();
    for path in new {
        let own = place(path);
        if own.is_some() && places.contains(&own) {
            return Err(Usage(format!("{} is named twice; give each file a name of its own", path.display())).into());
        }
        places.push(own);
    }
    Ok(())
}

pub(crate) fn same(a: &Path, b: &Path) -> bool {
    place(a).is_some_and(|a| Some(a) == place(b))
}

/// Where a file is or will be. One that is not there yet has no place of its own, but its folder has.
fn place(path: &Path) -> Option<PathBuf> {
    path.canonicalize().ok().or_else(|| Some(folder_of(path).canonicalize().ok()?.join(path.file_name()?)))
}

/// Reads points, `x y z` a line. Empty lines and lines that begin with `#` are left out.
pub(crate) fn read_points(path: &Path) -> Result<Vec<DVec3>> {
    let text = read_text(path)?;
    Ok(io::lists::points(&text, usize::MAX, &Token::default())
        .map_err(|error| BadInput(format!("{}: {error}", path.display())))?)
}

/// Writes points, `x y z` a line, 17 significant digits.
pub(crate) fn write_points(path: &Path, points: &[DVec3]) -> Result<()> {
    write(path, |out| {
        for p in points {
            writeln!(out, "{:.16e} {:.16e} {:.16e}", p.x, p.y, p.z)?;
        }
        Ok(())
    })
}

pub(crate) fn write_json(path: &Path, report: &impl serde::Serialize) -> Result<()> {
    write(path, |out| {
        serde_json::to_writer_pretty(&mut *out, report)?;
        writeln!(out)
    })
}

/// Writes a file. What has its name is replaced once the new one is whole.
pub(crate) fn write(path: &Path, body: impl FnOnce(&mut dyn Write) -> std::io::Result<()>) -> Result<()> {
    let mut out = Output::begin(path)?;
    body(&mut out.body).map_err(|error| unwritten(path, &error))?;
    out.finish()
}

/// A file that is being written. It gets its name at the end; one that is dropped before leaves nothing behind.
pub(crate) struct Output {
    path: PathBuf,
    body: BufWriter<File>,
    /// The name until then; none of a device or a pipe.
    temporary: Option<TempPath>,
}

impl Output {
    pub(crate) fn begin(path: &Path) -> Result<Self> {
        let open = || match is_stream(path) {
            true => Ok((OpenOptions::new().write(true).open(path)?, None)),
            false => begin(path).map(NamedTempFile::into_parts).map(|(file, name)| (file, Some(name))),
        };
        let (file, temporary) = open().map_err(|error| unwritten(path, &error))?;
        Ok(Self { path: path.to_owned(), body: BufWriter::new(file), temporary })
    }

    pub(crate) fn add(&mut self, bytes: &[u8]) -> Result<()> {
        Ok(self.body.write_all(bytes).map_err(|error| unwritten(&self.path, &error))?)
    }

    pub(crate) fn finish(self) -> Result<()> {
        let Self { path, mut body, temporary } = self;
        let end = || {
            body.flush()?;
            drop(body);
            temporary.map_or(Ok(()), |name| keep(name, &path))
        };
        Ok(end().map_err(|error: std::io::Error| unwritten(&path, &error))?)
    }
}

pub(crate) fn unwritten(path: &Path, error: &std::io::Error) -> NotWritten {
    NotWritten(format!("cannot write {}: {error}", path.display()))
}

/// A file beside `path`, with the rights that a file has there.
pub(crate) fn begin(path: &Path) -> std::io::Result<NamedTempFile> {
    let path = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let mut builder = tempfile::Builder::new();
    // By itself a temporary file is its owner's alone.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let file = builder.tempfile_in(folder_of(&path))?;
    if let Ok(meta) = std::fs::metadata(&path) {
        file.as_file().set_permissions(meta.permissions())?;
    }
    Ok(file)
}

/// Gives what was begun its name; a link goes on to point there.
pub(crate) fn keep(temporary: TempPath, path: &Path) -> std::io::Result<()> {
    Ok(temporary.persist(path.canonicalize().unwrap_or_else(|_| path.to_owned()))?)
}

/// Refuses a file whose vertices have no numbers, for which `option` has a list.
pub(crate) fn check_numbered(input: &Surface, option: &str) -> Result<()> {
    if input.is_standard() {
        return Err(Usage(format!("{option}: needs a file; the standard input can be read only once")).into());
    }
    let numbered = FileVertices::are_numbered(input.format(INPUT_FORMAT)?);
    if numbered { Ok(()) } else { Err(Usage(format!("{option}: {input}: {NO_NUMBERS}")).into()) }
}

/// Reads one number a line from `path`, for the vertices of the file `input`, which was read as `mesh`. Empty
/// lines and lines that begin with `#` are left out.
pub(crate) fn read_lengths(path: &Path, input: &Surface, mesh: &TriMesh) -> Result<Vec<f64>> {
    list(path, input, mesh, |vertices, text| vertices.lengths(text, &Token::default()))
}

/// Reads a metric tensor for each vertex of the file `input`, which was read as `mesh`.
pub(crate) fn read_metric(path: &Path, input: &Surface, mesh: &TriMesh) -> Result<Vec<Tensor>> {
    let tensors = read_tensors(path)?;
    let ordered = numbering(input, mesh)?.tensors(tensors);
    Ok(ordered.map_err(|error| BadInput(format!("{}: {error}", path.display())))?)
}

/// Reads the metric tensors of a file.
pub(crate) fn read_tensors(path: &Path) -> Result<Vec<Tensor>> {
    let bytes = std::fs::read(path).map_err(|cause| NoInput { path: path.to_owned(), cause })?;
    let tensors = io::metric::read(&path.to_string_lossy(), &bytes, &Token::default());
    Ok(tensors.map_err(|error| BadInput(format!("{}: {error}", path.display())))?)
}

/// Reads two vertices of the file `input` a line from `path`, numbered from 0: edges of `mesh`, which was read from it.
/// Empty lines and lines that begin with `#` are left out.
pub(crate) fn read_edges(path: &Path, input: &Surface, mesh: &TriMesh) -> Result<Vec<[u32; 2]>> {
    list(path, input, mesh, |vertices, text| vertices.edges(text, mesh.facets().len(), &Token::default()))
}

/// Gives vertices of the file `input` that parts name the numbers of `mesh`, which was read from it.
pub(crate) fn renumber(parts: &mut [Part], input: &Surface, mesh: &TriMesh) -> Result<()> {
    let names = parts.iter().any(|part| matches!(part, Part::Vertices(_)));
    if !names || !FileVertices::needs_bytes(input.format(INPUT_FORMAT)?) {
        return Ok(());
    }
    check_numbered(input, "--keep vertices:")?;
    Ok(numbering(input, mesh)?.renumber(parts).map_err(|error| BadInput(format!("--keep: {error}")))?)
}

fn list<T>(
    path: &Path,
    input: &Surface,
    mesh: &TriMesh,
    read: impl FnOnce(&FileVertices, &str) -> Result<T, DataError>,
) -> Result<T> {
    let text = read_text(path)?;
    Ok(read(&numbering(input, mesh)?, &text).map_err(|error| BadInput(format!("{}: {error}", path.display())))?)
}

/// How the vertices of `input` are numbered in `mesh`, which was read from it.
fn numbering(input: &Surface, mesh: &TriMesh) -> Result<FileVertices> {
    let format = input.format(INPUT_FORMAT)?;
    let bytes = if FileVertices::needs_bytes(format) { input.bytes(format)? } else { Vec::new() };
    let vertices = FileVertices::of(format, &bytes, mesh);
    Ok(vertices.map_err(|error| BadInput(format!("{input}: {error}")))?)
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use glam::DVec3;

    use super::*;
    use geometry::mesh::io;

    #[test]
    fn points_come_back_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("points.xyz");
        let points = vec![DVec3::new(0.1, -1e-300, 123_456_789.123_456_79), DVec3::new(1.0 / 3.0, 0.0, f64::MAX)];
        write_points(&path, &points).unwrap();
        assert_eq!(read_points(&path).unwrap(), points);
    }

    #[test]
    fn a_bad_line_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("points.xyz");
        std::fs::write(&path, "0 0 0\n# fine\n1 2 nan\n").unwrap();
        assert!(read_points(&path).unwrap_err().to_string().contains("line 3"));
    }

    #[test]
    fn lengths_follow_the_vertices_of_an_obj() {
        let folder = tempfile::tempdir().unwrap();
        let (input, path) = (folder.path().join("a.obj"), folder.path().join("sizes.txt"));
        let obj = "v 9 9 9\nv 0 0 0 # first\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nf 4/1 \\\n 5/1 2/1\nf -4 -3 -2/1\n";
        std::fs::write(&input, obj).unwrap();
        std::fs::write(&path, "# a length each\n0.9\n0.1\n\n0.2\n0.3\n0.4\n").unwrap();
        let mesh = io::read(&input).unwrap();
        let sizes = read_lengths(&path, &Surface::new(&input, None), &mesh).unwrap();
        let want = |p: &DVec3| 0.1 + 0.1 * if p.y == 0.0 { p.x } else { 3.0 - p.x };
        assert_eq!(sizes.len(), 4, "the vertex that no face uses is left out");
        for (p, h) in mesh.positions().iter().zip(&sizes) {
            assert!((h - want(p)).abs() < 1e-12, "{p}: {h}");
        }
        // A homogeneous coordinate moves vertices, and changes no number.
        std::fs::write(&input, obj.replace("v 1 1 0", "v 2 2 0 2")).unwrap();
        let divided = io::read(&input).unwrap();
        assert_eq!(divided.positions(), mesh.positions());
        assert_eq!(read_lengths(&path, &Surface::new(&input, None), &divided).unwrap(), sizes);
    }

    #[test]
    fn a_bad_line_and_a_wrong_count_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let (input, path) = (folder.path().join("a.off"), folder.path().join("sizes.txt"));
        std::fs::write(&input, "OFF 3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n").unwrap();
        let mesh = io::read(&input).unwrap();
        std::fs::write(&path, "1\n2\n3\n").unwrap();
        assert_eq!(read_lengths(&path, &Surface::new(&input, None), &mesh).unwrap(), [1.0, 2.0, 3.0]);
        std::fs::write(&path, "1\n2\n-3\n").unwrap();
        assert!(read_lengths(&path, &Surface::new(&input, None), &mesh).unwrap_err().to_string().contains("line 3"));
        std::fs::write(&path, "1\n2\n").unwrap();
        assert!(
            read_lengths(&path, &Surface::new(&input, None), &mesh).unwrap_err().to_string().contains("3 vertices")
        );
        assert!(check_numbered(&Surface::new(Path::new("a.stl"), None), "--sizes").is_err());
    }

    #[test]
    fn edges_follow_the_vertices_of_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("creases.txt");
        std::fs::write(&path, "# from 0\n1 2\n\n 4 1\n").unwrap();
        let files = [
            ("a.obj", "v 9 9 9\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 4 5 2\nf 2 3 4\n"),
            ("a.off", "OFF 5 2 0\n9 9 9\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 3 4 1\n3 1 2 3\n"),
        ];
        for (name, text) in files {
            let input = folder.path().join(name);
            std::fs::write(&input, text).unwrap();
            let mesh = io::read(&input).unwrap();
            let at = |v: u32| mesh.positions()[v as usize];
            let edges = read_edges(&path, &Surface::new(&input, None), &mesh).unwrap();
            let ends: Vec<[DVec3; 2]> = edges.iter().map(|e| e.map(at)).collect();
            assert_eq!(ends, [[DVec3::ZERO, DVec3::X], [DVec3::Y, DVec3::ZERO]], "{name}");
            let mut parts = ["vertices:2,4".parse().unwrap()];
            renumber(&mut parts, &Surface::new(&input, None), &mesh).unwrap();
            let [Part::Vertices(kept)] = &parts else { panic!("{parts:?}") };
            let kept: HashSet<String> = kept.iter().map(|v| at(v).to_string()).collect();
            assert_eq!(kept, [DVec3::X, DVec3::Y].map(|p| p.to_string()).into(), "{name}");
            for bad in ["1 2\n1\n", "1 2\n1 2 3\n", "1 2\n-1 2\n", "1 2\n1 5\n", "1 2\n1 x\n"] {
                let path = folder.path().join("bad.txt");
                std::fs::write(&path, bad).unwrap();
                let error = read_edges(&path, &Surface::new(&input, None), &mesh).unwrap_err().to_string();
                assert!(error.contains("line 2"), "{name}, {bad:?}: {error}");
            }
        }
    }
}
