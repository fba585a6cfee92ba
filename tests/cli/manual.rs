//! Promise: every command has a page of the manual, completions and a row in the documents, made of its own options.

use std::path::Path;
use std::process::{Command, Output};

fn tessera(words: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tessera"));
    // The pages say which variables there are, and not what they are here.
    command.env("TESSERA_TENANT", "somebody").args(words).output().unwrap()
}

fn said(words: &[&str]) -> String {
    let out = tessera(words);
    assert!(out.status.success(), "{words:?}: {out:?}");
    String::from_utf8(out.stdout).unwrap()
}

/// The commands that `tessera ... --help` lists.
fn listed(words: &[&str]) -> Vec<String> {
    let help = said(&[words, &["--help"]].concat());
    let Some((_, commands)) = help.split_once("Commands:\n") else { return Vec::new() };
    let rows = commands.lines().take_while(|line| !line.is_empty());
    // What goes on in the next line is indented more.
    let names = rows.filter_map(|line| line.strip_prefix("  ")?.split(' ').next().map(str::to_owned));
    names.filter(|name| !name.is_empty() && name != "help").collect()
}

/// Every command with all of its words.
pub(super) fn commands() -> Vec<Vec<String>> {
    let mut all = vec![Vec::new()];
    let mut at = 0;
    while let Some(words) = all.get(at).cloned() {
        let plain: Vec<&str> = words.iter().map(String::as_str).collect();
        all.extend(listed(&plain).into_iter().map(|name| [words.clone(), vec![name]].concat()));
        at += 1;
    }
    all
}

#[test]
fn every_command_has_a_page() {
    let folder = tempfile::tempdir().unwrap();
    said(&["man", "--out-dir", folder.path().to_str().unwrap()]);
    let commands = commands();
    assert!(commands.len() > 30 && commands.contains(&vec!["jobs".to_owned(), "submit".to_owned()]), "{commands:?}");
    for words in &commands {
        let page = [vec!["tessera".to_owned()], words.clone()].concat().join("-") + ".1";
        let text = std::fs::read_to_string(folder.path().join(&page)).expect(&page);
        assert!(text.contains(".SH NAME") && text.contains(".SH SYNOPSIS"), "{page}");
        assert!(!text.contains("somebody"), "{page} says what a variable is here");
    }
    let pages = std::fs::read_dir(folder.path()).unwrap().count();
    assert_eq!(pages, commands.len(), "pages of what is no command");
    let serve = std::fs::read_to_string(folder.path().join("tessera-serve.1")).unwrap();
    assert!(serve.contains("TESSERA_LISTEN"), "variables are on the page");
    assert!(said(&["man"]).contains("remesh"));
    let nowhere = tessera(&["man", "--out-dir", "/no/such/folder"]);
    assert_eq!(nowhere.status.code(), Some(73), "{nowhere:?}");
}

#[test]
fn the_page_of_commands_has_them_all() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/command-line.md");
    let page = std::fs::read_to_string(page).unwrap();
    let missing: Vec<String> = listed(&[])
        .into_iter()
        .filter(|name| !page.lines().any(|line| line.starts_with(&format!("| `{name}` |"))))
        .collect();
    assert!(missing.is_empty(), "docs/command-line.md has no row for {missing:?}");
}

#[test]
fn the_page_of_commands_has_every_exit_code() {
    let page = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/command-line.md")).unwrap();
    let section = page.split("## ").find(|part| part.starts_with("Exit codes")).expect("a section of exit codes");
    let number = |text: &str| text.trim().split([' ', '|']).next().and_then(|word| word.parse::<u8>().ok());
    let rows: Vec<u8> = section.lines().filter_map(|line| number(line.strip_prefix('|')?)).collect();
    let help = said(&["--help"]);
    let (_, codes) = help.split_once("Exit codes:\n").expect("exit codes");
    let told: Vec<u8> = codes.lines().filter_map(number).collect();
    assert!(told.len() > 5 && rows == told, "the page has {rows:?}, --help {told:?}");
}

#[test]
fn shells_complete_every_command() {
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let text = said(&["completions", shell]);
        assert!(text.contains("remesh") && text.contains("edge-length"), "{shell}");
    }
    assert_eq!(tessera(&["completions", "dos"]).status.code(), Some(2));
    assert_eq!(tessera(&["completions"]).status.code(), Some(2));
    let folder = tempfile::tempdir().unwrap();
    let script = folder.path().join("script");
    std::fs::write(&script, said(&["completions", "bash"])).unwrap();
    // Where there is no bash nobody completes in it.
    if let Ok(read) = Command::new("bash").arg("-n").arg(&script).output() {
        assert!(read.status.success(), "{read:?}");
    }
}
