//! Promise: every command has a page of the manual and completions, made of its own options.

use std::process::{Command, Stdio};

fn tessera(words: &[&str]) -> std::process::Output {
    Command::new(env!("CARGO_BIN_EXE_tessera")).args(words).output().unwrap()
}

#[test]
fn every_command_has_a_page() {
    let folder = tempfile::tempdir().unwrap();
    let told = tessera(&["man", "--out-dir", folder.path().to_str().unwrap()]);
    assert!(told.status.success(), "{told:?}");
    for page in ["tessera", "tessera-remesh", "tessera-serve", "tessera-jobs-submit", "tessera-keys-add", "tessera-man"]
    {
        let text = std::fs::read_to_string(folder.path().join(format!("{page}.1"))).expect(page);
        assert!(text.contains(".SH NAME") && text.contains(".SH SYNOPSIS"), "{page}");
    }
    let first = tessera(&["man"]);
    let text = String::from_utf8(first.stdout).unwrap();
    assert!(text.contains("tessera\\-remesh(1)") || text.contains("remesh"), "{text}");
    let nowhere = tessera(&["man", "--out-dir", "/no/such/folder"]);
    assert_eq!(nowhere.status.code(), Some(73), "{nowhere:?}");
}

#[test]
fn shells_complete_every_command() {
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let told = tessera(&["completions", shell]);
        let text = String::from_utf8(told.stdout).unwrap();
        assert!(text.contains("remesh") && text.contains("edge-length"), "{shell}");
    }
    assert_eq!(tessera(&["completions", "dos"]).status.code(), Some(2));
    let folder = tempfile::tempdir().unwrap();
    let script = folder.path().join("script");
    std::fs::write(&script, tessera(&["completions", "bash"]).stdout).unwrap();
    let read = Command::new("bash").arg("-n").arg(&script).stderr(Stdio::piped()).output();
    if let Ok(read) = read {
        assert!(read.status.success(), "{read:?}");
    }
}
