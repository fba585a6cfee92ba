//! Options in a file.
//!
//! Purpose: [`ConfigFile`] reads TOML whose keys are the names of the options with `_` for `-`, and makes each value the
//! default of its option. Invariant: an unknown key, a value of the wrong type and an invalid value are refused with file,
//! line and key. Must not know: the list of options.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::ops::Range;
use std::path::{Path, PathBuf};

use clap::builder::OsStr;
use clap::parser::ValueSource;
use clap::{Arg, ArgMatches, Command};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::args::Source;
use super::options::{Kind, is_key, is_list, kind, options, takes};
use crate::config::args::Sources;

/// No file of options is longer; a device that never ends is no such file.
const LONGEST_BYTES: u64 = 1 << 20;

/// Letters that may be wrong in a key for another to be meant.
const NEAR: usize = 3;

#[derive(Debug, thiserror::Error)]
pub enum FileError {
    #[error("cannot read the configuration {}: {cause}; name another with --config", file.display())]
    Read { file: PathBuf, cause: std::io::Error },
    #[error("the configuration {} {what}", file.display())]
    Unreadable { file: PathBuf, what: &'static str },
    #[error("{}:{line}: {what}", file.display())]
    Line {
        file: PathBuf,
        /// From 1 on.
        line: usize,
        what: String,
    },
}

#[derive(Debug)]
struct Entry {
    line: usize,
    values: Vec<String>,
}

#[derive(Debug)]
pub struct ConfigFile {
    path: PathBuf,
    entries: BTreeMap<String, Entry>,
}

impl ConfigFile {
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let cannot = |cause| FileError::Read { file: path.to_owned(), cause };
        let mut bytes = Vec::new();
        File::open(path).and_then(|file| file.take(LONGEST_BYTES + 1).read_to_end(&mut bytes)).map_err(cannot)?;
        let unreadable = |what| FileError::Unreadable { file: path.to_owned(), what };
        if bytes.len() as u64 > LONGEST_BYTES {
            return Err(unreadable("is longer than 1 MiB; it holds options alone"));
        }
        let text = String::from_utf8(bytes).map_err(|_| unreadable("is no text in UTF-8"))?;
        Self::parse(path, &text)
    }

    pub(super) fn parse(path: &Path, text: &str) -> Result<Self, FileError> {
        let wrong = |at: usize, what: String| {
            let line = 1 + text.as_bytes()[..at.min(text.len())].iter().filter(|byte| **byte == b'\n').count();
            FileError::Line { file: path.to_owned(), line, what }
        };
        let start = |span: Option<Range<usize>>| span.map_or(0, |span| span.start);
        let table = DeTable::parse(text).map_err(|e| wrong(start(e.span()), format!("no TOML: {}", e.message())))?;
        let command = options();
        let mut entries = BTreeMap::new();
        for (key, value) in table.get_ref() {
            let (at, name) = (key.span().start, key.get_ref().as_ref());
            let arg = command.get_arguments().find(|arg| is_key(arg) && arg.get_id() == name);
            let arg = arg.ok_or_else(|| wrong(at, unknown(&command, name, value.get_ref())))?;
            let values = values(arg, value).map_err(|what| wrong(at, format!("{name}: {what}")))?;
            for value in &values {
                takes(arg, value).map_err(|what| wrong(at, format!("{name}: {what}")))?;
            }
            let line = 1 + text[..at].matches('\n').count();
            entries.insert(name.to_owned(), Entry { line, values });
        }
        Ok(Self { path: path.to_owned(), entries })
    }

    /// Where the file has a key, if it does.
    pub(super) fn source(&self, key: &str) -> Option<Source> {
        self.entries.get(key).map(|entry| Source::File { file: self.path.display().to_string(), line: entry.line })
    }

    /// Makes its values the defaults of `command`'s options.
    pub fn apply(&self, command: Command) -> Command {
        command.mut_args(|arg| match self.entries.get(arg.get_id().as_str()) {
            Some(entry) => arg.default_values(entry.values.iter().map(|value| OsStr::from(value.clone()))),
            None => arg,
        })
    }
}

/// The texts of a value, as the command line would have them.
fn values(arg: &Arg, value: &Spanned<DeValue<'_>>) -> Result<Vec<String>, String> {
    match value.get_ref() {
        DeValue::Array(all) if is_list(arg) => all.iter().map(|value| one(arg, value.get_ref())).collect(),
        value => Ok(vec![one(arg, value)?]),
    }
}

fn one(arg: &Arg, value: &DeValue<'_>) -> Result<String, String> {
    let text = match (kind(arg), value) {
        (Kind::Switch, DeValue::Boolean(value)) => Some(value.to_string()),
        (Kind::Number, DeValue::Integer(number)) => {
            i128::from_str_radix(number.as_str(), number.radix()).ok().map(|number| number.to_string())
        }
        (Kind::Number, DeValue::Float(number)) => Some(number.as_str().to_owned()),
        (Kind::Text, DeValue::String(text)) => Some(text.to_string()),
        _ => None,
    };
    text.ok_or_else(|| {
        let must = match kind(arg) {
            Kind::Switch => "true or false",
            Kind::Number => "a number, without quotes",
            Kind::Text => "a text in quotes",
        };
        format!("this is {} {}; it must be {must}", article(value.type_str()), value.type_str())
    })
}

fn article(word: &str) -> &'static str {
    if word.starts_with(['a', 'e', 'i', 'o', 'u']) { "an" } else { "a" }
}

fn unknown(command: &Command, key: &str, value: &DeValue<'_>) -> String {
    if value.is_table() {
        return format!("{key}: there are no tables; keys stand at the top, as `max_streams = 256`");
    }
    if key == super::options::CONFIG {
        return format!("{key}: a configuration names no other; give --config");
    }
    let keys = command.get_arguments().filter(|arg| is_key(arg)).map(|arg| arg.get_id().as_str());
    let nearest = keys.map(|known| (strsim::levenshtein(key, known), known)).min();
    let hint = match nearest {
        Some((far, known)) if far <= NEAR.min(key.len() / 2) => format!("; {known} may be meant"),
        _ => "; `tessera config print --defaults` lists all keys".to_owned(),
    };
    format!("{key}: there is no such option{hint}")
}

/// The sources of clap's values, with the keys of `file` as defaults.
pub fn sources(found: &ArgMatches, file: Option<&ConfigFile>) -> Sources {
    let of = |arg: &clap::Arg| {
        let (id, long) = (arg.get_id().as_str(), arg.get_long()?);
        Some(match found.try_contains_id(id).ok().and_then(|_| found.value_source(id))? {
            ValueSource::EnvVariable => Source::Environment(arg.get_env()?.to_string_lossy().into_owned()),
            ValueSource::CommandLine => Source::Line(format!("--{long}")),
            _ => file.and_then(|file| file.source(id)).unwrap_or(Source::Default),
        })
    };
    let command = options();
    let keys = command.get_arguments().filter(|arg| is_key(arg));
    Sources(keys.filter_map(|arg| Some((arg.get_id().to_string(), of(arg)?))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(text: &str) -> String {
        ConfigFile::parse(Path::new("t.toml"), text).unwrap_err().to_string()
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        for (text, words) in [
            ("max_streems = 5", &["t.toml:1: max_streems: there is no such option; max_streams may be meant"][..]),
            ("\n\nmax-streams = 5", &["t.toml:3: max-streams", "max_streams may be meant"]),
            ("colour = 5", &["t.toml:1: colour", "lists all keys"]),
            ("listen = 5", &["t.toml:1: listen: this is an integer; it must be a text in quotes"]),
            ("max_streams = \"5\"", &["max_streams: this is a string; it must be a number"]),
            ("max_streams = [5]", &["max_streams: this is an array"]),
            ("ephemeral = 1", &["ephemeral: this is an integer; it must be true or false"]),
            ("data_dir = 1979-05-27", &["data_dir: this is a datetime"]),
            ("# why\nmax_streams = -5", &["t.toml:2: max_streams: ", "a whole number is needed"]),
            ("max_streams = 1.5", &["max_streams: ", "a whole number is needed"]),
            ("keep_results = \"7\"", &["keep_results: ", "as 90s, 30m, 24h or 7d"]),
            ("backend = \"cuda\"", &["backend: ", "possible values: auto, gpu"]),
            ("[limits]\nmax_streams = 5", &["t.toml:1: limits: there are no tables"]),
            ("config = \"other.toml\"", &["t.toml:1: config: a configuration names no other"]),
            ("max_streams = 5\nmax_streams = 6", &["t.toml:2: no TOML: "]),
            ("max_streams =", &["t.toml:1: no TOML: "]),
            ("help = true", &["help: there is no such option"]),
        ] {
            let refused = refused(text);
            assert!(words.iter().all(|word| refused.contains(word)), "{text}: {refused}");
            assert!(!refused.contains('\n'), "{refused}");
        }
    }

    #[test]
    fn a_file_that_is_none_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str, bytes: &[u8]| {
            let path = folder.path().join(name);
            std::fs::write(&path, bytes).unwrap();
            ConfigFile::read(&path).unwrap_err().to_string()
        };
        assert!(file("binary", &[0xff, 0xfe]).contains("is no text"));
        assert!(file("long", &vec![b'#'; 1 << 20 | 1]).contains("longer than 1 MiB"));
        assert!(ConfigFile::read(folder.path()).unwrap_err().to_string().contains("cannot read"));
        assert!(ConfigFile::read(&folder.path().join("none")).unwrap_err().to_string().contains("--config"));
    }

    #[test]
    fn numbers_may_be_written_in_any_way_of_toml() {
        let file = ConfigFile::parse(
            Path::new("t.toml"),
            "max_streams = 0x10\nmax_seeds = 1_000\nmax_facets = 2e3\nstuck_s = 7",
        )
        .unwrap();
        let found = file.apply(super::super::options::untouched()).try_get_matches_from(["serve"]).unwrap();
        assert_eq!(found.get_one::<usize>("max_streams"), Some(&16));
        assert_eq!(found.get_one::<u64>("max_seeds"), Some(&1000));
        assert_eq!(found.get_one::<u64>("max_facets"), Some(&2000));
        assert_eq!(found.get_one::<f64>("stuck_s"), Some(&7.0));
    }
}
