//! The file of the keys.
//!
//! Purpose: [`KeyFile`] reads and changes `keys.json` in a server's folder, while the server runs or not. Invariant: the
//! file is written completely under another name and renamed, readable by its user alone; concurrent changes are not lost.
//! A missing file is an empty set. Must not know: the use of keys.

use std::fs::{self, File, OpenOptions};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use super::{KeySet, KeysError};
use transport::read_regular;

/// The file, the one that is being written, and the one that is locked meanwhile.
const NAME: &str = "keys.json";
const NEXT: &str = "keys.json.new";
const LOCK: &str = "keys.lock";

/// A longer file is none of keys.
const MOST_BYTES: u64 = 16 << 20;

#[derive(Clone, Debug)]
pub struct KeyFile {
    folder: PathBuf,
}

/// By which a change of the file is seen without reading it. A file that was renamed into its place has a number of its own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stamp {
    changed: Option<SystemTime>,
    length: u64,
    number: u64,
}

impl KeyFile {
    pub fn in_folder(folder: impl Into<PathBuf>) -> Self {
        Self { folder: folder.into() }
    }

    pub fn path(&self) -> PathBuf {
        self.folder.join(NAME)
    }

    pub fn stamp(&self) -> Stamp {
        let Ok(found) = fs::metadata(self.path()) else { return Stamp::default() };
        #[cfg(unix)]
        let number = std::os::unix::fs::MetadataExt::ino(&found);
        #[cfg(not(unix))]
        let number = 1;
        Stamp { changed: found.modified().ok(), length: found.len(), number }
    }

    pub fn read(&self) -> Result<KeySet, KeysError> {
        let path = self.path();
        match read_regular(&path, MOST_BYTES) {
            Ok(bytes) => KeySet::from_json(&bytes).map_err(|reason| KeysError::Damaged { path, reason }),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(KeySet::default()),
            Err(error) if error.kind() == ErrorKind::FileTooLarge => {
                Err(KeysError::Damaged { path, reason: error.to_string() })
            }
            Err(source) => Err(KeysError::Io { action: "read", path, source }),
        }
    }

    /// Changes the keys, unless `change` fails. Errors: `Io`, `Damaged`, and the errors of `change`.
    pub fn change<R>(&self, change: impl FnOnce(&mut KeySet) -> Result<R, KeysError>) -> Result<R, KeysError> {
        let io = |action: &'static str, path: &Path| {
            let path = path.to_owned();
            move |source| KeysError::Io { action, path, source }
        };
        fs::create_dir_all(&self.folder).map_err(io("make", &self.folder))?;
        let path = self.folder.join(LOCK);
        let mut options = OpenOptions::new();
        let lock = private(options.write(true).create(true).truncate(false)).open(&path).map_err(io("make", &path))?;
        // Other commands hold the lock briefly. It is released when the file is closed.
        lock.lock().map_err(io("lock", &path))?;
        let mut set = self.read()?;
        let changed = change(&mut set)?;
        let next = self.folder.join(NEXT);
        let written = self.write(&next, set.to_json().as_bytes());
        written.inspect_err(|_| drop(fs::remove_file(&next))).map_err(io("write", &self.path()))?;
        Ok(changed)
    }

    fn write(&self, next: &Path, bytes: &[u8]) -> std::io::Result<()> {
        // A remainder of an interrupted command.
        match fs::remove_file(next) {
            Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let mut file = private(OpenOptions::new().write(true).create_new(true)).open(next)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        fs::rename(next, self.path())?;
        // So that a loss of power does not bring back a key that was revoked. Elsewhere folders cannot be opened.
        #[cfg(unix)]
        File::open(&self.folder)?.sync_all()?;
        Ok(())
    }
}

/// For its user alone.
fn private(options: &mut OpenOptions) -> &mut OpenOptions {
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(options, 0o600);
    options
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::keys::{KeyLimits, NewKey, Role};

    fn new(name: String) -> NewKey {
        NewKey { name, role: Role::Read, lasts: None, limits: KeyLimits::default(), is_second: false }
    }

    #[test]
    fn commands_at_once_lose_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let file = KeyFile::in_folder(folder.path().join("made"));
        assert!(file.read().unwrap().keys().is_empty() && file.stamp() == Stamp::default());
        std::thread::scope(|scope| {
            for thread in 0..4 {
                let file = &file;
                scope.spawn(move || {
                    for i in 0..8 {
                        file.change(|set| set.add(new(format!("k{thread}-{i}")))).unwrap();
                    }
                    file.change(|set| set.revoke(&format!("k{thread}-3"))).unwrap();
                });
            }
        });
        assert_eq!(file.read().unwrap().keys().len(), 28);
        let before = file.stamp();
        assert!(file.change(|set| set.add(new("k0-0".to_owned()))).is_err());
        assert_eq!(file.stamp(), before, "what fails changes nothing");
        file.change(|set| set.revoke("k0-0")).unwrap();
        assert_ne!(file.stamp(), before);
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            assert_eq!(fs::metadata(file.path()).unwrap().permissions().mode() & 0o777, 0o600);
        }
    }

    #[test]
    fn a_damaged_file_is_said_and_stays() {
        let folder = tempfile::tempdir().unwrap();
        let file = KeyFile::in_folder(folder.path());
        for damage in [&b""[..], b"{", b"{\"version\":1}", b"\xff\xfe"] {
            fs::write(file.path(), damage).unwrap();
            assert!(matches!(file.read(), Err(KeysError::Damaged { .. })));
            assert!(matches!(file.change(|set| set.revoke("a")), Err(KeysError::Damaged { .. })));
            assert_eq!(fs::read(file.path()).unwrap(), damage);
        }
    }
}
