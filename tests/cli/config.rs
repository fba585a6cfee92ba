//! Promise: an option can be set by the file, the environment and the command line, in rising precedence; what is printed
//! can be read back; what makes no sense is refused before anything is done.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Output};

use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};

/// The program without what this machine's environment says.
fn tessera(folder: &Path, line: &[String], variables: &[(String, String)]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tessera"));
    for (name, _) in std::env::vars_os() {
        if name.to_string_lossy().starts_with("TESSERA_") {
            command.env_remove(name);
        }
    }
    let variables = variables.iter().map(|(name, value)| (name, value));
    command.envs(variables).args(line).current_dir(folder).output().unwrap()
}

fn words(line: &str) -> Vec<String> {
    line.split_whitespace().map(str::to_owned).collect()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// Keys and values as `config print` has them, and where each came from.
fn printed(out: &Output) -> BTreeMap<String, (String, String)> {
    let all = text(&out.stdout);
    let lines = all.lines().filter(|line| !line.starts_with('#') && !line.is_empty());
    lines
        .map(|line| {
            let (key, rest) = line.split_once(" = ").expect(line);
            let (value, source) = rest.rsplit_once("  # ").expect(line);
            (key.to_owned(), (value.to_owned(), source.to_owned()))
        })
        .collect()
}

/// The keys that have no value unless one is given.
fn unset(out: &Output) -> Vec<String> {
    let all = text(&out.stdout);
    all.lines().filter_map(|line| Some(line.strip_prefix("# ")?.strip_suffix(" is not set")?.to_owned())).collect()
}

fn flag(key: &str) -> String {
    format!("--{}", key.replace('_', "-"))
}

fn variable(key: &str) -> String {
    format!("TESSERA_{}", key.to_uppercase())
}

/// Three values that an option takes, as the file has them.
fn values(key: &str, default: Option<&str>) -> [String; 3] {
    let all = match default {
        _ if key == "on_device_loss" => ["\"exit\"", "\"cpu\"", "\"exit\""],
        _ if key == "role" => ["\"gateway\"", "\"worker\"", "\"all\""],
        _ if key == "public_host" => ["[\"a\"]", "[\"b\"]", "[\"c\"]"],
        _ if key == "cors_origin" => ["[\"http://a\"]", "[\"http://b\"]", "[\"http://c\"]"],
        _ if key == "gpu_adapters" => ["\"2\"", "\"3\"", "\"all\""],
        _ if key == "backend" => ["\"gpu\"", "\"serial\"", "\"parallel\""],
        Some("true" | "false") => ["true", "false", "true"],
        Some(text) if text.starts_with('"') && text.ends_with("h\"") || text.ends_with("d\"") => {
            ["\"3s\"", "\"4m\"", "\"5h\""]
        }
        Some(text) if text.starts_with('"') => ["\"a:1\"", "\"b:2\"", "\"c:3\""],
        Some(text) if text.contains('.') => ["3.5", "4.5", "5.5"],
        Some(_) => ["3", "4", "5"],
        None if key.ends_with("dir") || key.starts_with("tls") || key.ends_with("ca") || key.ends_with("file") => {
            ["\"/a b\"", "\"c\\\"d\"", "\"e\""]
        }
        None => ["3", "4", "5"],
    };
    all.map(str::to_owned)
}

/// As it stands on the command line or in a variable.
fn plain(value: &str) -> String {
    value.trim_matches(['[', ']']).trim_matches('"').replace("\\\"", "\"")
}

#[test]
fn every_option_can_be_set_in_three_ways() {
    let folder = tempfile::tempdir().unwrap();
    let defaults = tessera(folder.path(), &words("config print --defaults"), &[]);
    let mut keys: BTreeMap<String, Option<String>> =
        printed(&defaults).into_iter().map(|(key, (value, _))| (key, Some(value))).collect();
    keys.extend(unset(&defaults).into_iter().map(|key| (key, None)));
    assert!(keys.len() > 40, "{keys:?}");

    // Some take numbers and some texts; what a first look guesses wrong, the file's refusal puts right.
    let mut chosen: BTreeMap<String, [String; 3]> =
        keys.iter().map(|(key, default)| (key.clone(), values(key, default.as_deref()))).collect();
    let path = folder.path().join("all.toml");
    let write = |chosen: &BTreeMap<String, [String; 3]>| {
        let lines: String = chosen.iter().map(|(key, [value, ..])| format!("{key} = {value}\n")).collect();
        std::fs::write(&path, lines).unwrap();
    };
    for _ in 0..keys.len() {
        write(&chosen);
        let out = tessera(folder.path(), &words("config print --config all.toml"), &[]);
        let told = text(&out.stderr);
        let Some(line) = told.strip_prefix("tessera: all.toml:") else { break };
        let wrong = line.split(": ").nth(1).unwrap().to_owned();
        let other = if told.contains("a text in quotes") { ["\"a\"", "\"b\"", "\"c\""] } else { ["3", "4", "5"] };
        assert_ne!(chosen[&wrong], other.map(str::to_owned), "{told}");
        chosen.insert(wrong, other.map(str::to_owned));
    }

    // Together they make no sense, which is said after they are printed.
    let file = words("config print --config all.toml");
    let variables: Vec<_> = chosen.iter().map(|(key, [_, value, _])| (variable(key), plain(value))).collect();
    let mut line = file.clone();
    line.extend(chosen.iter().map(|(key, [.., value])| format!("{}={}", flag(key), plain(value))));
    for (way, (line, variables)) in [(&file, &[][..]), (&file, &variables), (&line, &variables)].into_iter().enumerate()
    {
        let out = tessera(folder.path(), line, variables);
        let found = printed(&out);
        for (at, (key, values)) in chosen.iter().enumerate() {
            let (value, source) = found.get(key).unwrap_or_else(|| panic!("{key}: {}", text(&out.stderr)));
            assert_eq!(value, &values[way], "{key} from {source}");
            let expected = match way {
                0 => format!("all.toml:{}", at + 1),
                1 => format!("the variable {}", variable(key)),
                _ => format!("{} on the command line", flag(key)),
            };
            assert_eq!(source, &expected, "{key}");
        }
    }
    // And without a file.
    let found = printed(&tessera(folder.path(), &words("config print"), &variables));
    assert!(chosen.iter().all(|(key, [_, value, _])| &found[key].0 == value));
}

#[test]
fn a_variable_set_to_nothing_says_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let plain = tessera(folder.path(), &words("config print"), &[]);
    let mut keys: Vec<String> = printed(&plain).into_keys().chain(unset(&plain)).collect();
    keys.push("config".to_owned());
    let empty: Vec<_> = keys.iter().map(|key| (variable(key), String::new())).collect();
    let out = tessera(folder.path(), &words("config print"), &empty);
    assert_eq!((text(&out.stdout), text(&out.stderr)), (text(&plain.stdout), text(&plain.stderr)));
    std::fs::write(folder.path().join("a.toml"), "max_streams = 7\n").unwrap();
    let out = tessera(folder.path(), &words("config print --config a.toml"), &empty);
    assert_eq!(printed(&out)["max_streams"], ("7".into(), "a.toml:1".into()));
    // Those of other commands, too.
    let out = tessera(folder.path(), &words("keys list"), &[("TESSERA_DATA_DIR".into(), String::new())]);
    assert!(out.status.success(), "{}", text(&out.stderr));
    let out = tessera(folder.path(), &words("health"), &[("TESSERA_ENDPOINT".into(), String::new())]);
    assert!(!text(&out.stderr).contains("''"), "{}", text(&out.stderr));
}

#[test]
fn what_is_printed_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let line = words("config print --defaults");
    let defaults = tessera(folder.path(), &line, &[("TESSERA_MAX_STREAMS".into(), "7".into())]);
    assert_eq!(printed(&defaults)["max_streams"], ("256".into(), "default".into()));
    let path = folder.path().join("all.toml");
    let again = |line: &[String]| {
        let first = tessera(folder.path(), line, &[]);
        std::fs::write(&path, &first.stdout).unwrap();
        let second = tessera(folder.path(), &words("config print --config all.toml"), &[]);
        let values =
            |out: &Output| -> Vec<_> { printed(out).into_iter().map(|(key, (value, _))| (key, value)).collect() };
        assert_eq!(values(&second), values(&first), "{line:?}: {}", text(&second.stderr));
        assert_eq!(unset(&second), unset(&first));
        assert_eq!(second.status.code(), first.status.code());
    };
    again(&words("config print"));
    // Any values: what they are is for the check, that they come back is for this.
    let mut runner = TestRunner::new(Config { cases: 24, failure_persistence: None, ..Config::default() });
    let number = prop_oneof![any::<u32>().prop_map(|n| n.to_string()), Just("1e4".to_owned()), Just("007".to_owned())];
    let real = prop_oneof![
        any::<f64>().prop_filter("finite", |x| x.is_finite()).prop_map(|x| x.to_string()),
        Just(".5".into())
    ];
    let options = (number, real, "[^\\x00]{1,12}", any::<bool>());
    runner
        .run(&options, |(number, real, name, switch)| {
            let mut line = words("config print");
            line.extend([
                format!("--max-vertices={number}"),
                format!("--stuck-s={real}"),
                format!("--data-dir={name}"),
                format!("--listen={name}"),
                format!("--require-keys={switch}"),
            ]);
            again(&line);
            Ok(())
        })
        .unwrap();
}

#[test]
fn what_makes_no_sense_is_refused_before_anything_is_done() {
    let folder = tempfile::tempdir().unwrap();
    let write = |text: &str| std::fs::write(folder.path().join("c.toml"), text).unwrap();
    write("max_streams = 8\ndata_dir = \"state\"\nlisten = \"127.0.0.1:0\"\n");
    let out = tessera(folder.path(), &words("config check --config c.toml"), &[]);
    assert_eq!((out.status.code(), text(&out.stdout)), (Some(0), "good\n".to_owned()));
    for (file, line, words_said) in [
        ("max_streems = 8", "", &["c.toml:1: max_streems", "max_streams may be meant"][..]),
        ("max_streams = 0", "", &["--max-streams is 0 (c.toml:1)", "1 to 100000"]),
        ("stuck_s = nan", "", &["--stuck-s is NaN (c.toml:1)"]),
        ("max_streams = \"8\"", "", &["c.toml:1: max_streams", "a number"]),
        ("tls_cert = \"c\"", "", &["--tls-key is not given, though --tls-cert is"]),
        ("client_ca = \"c\"", "", &["--tls-cert is not given, though --client-ca is"]),
        ("tls_cert = \"c\"\ntls_key = \"k\"", "", &["cannot read c"]),
        ("otlp_endpoint = \"https://a\"", "", &["--otlp-endpoint is https://a (c.toml:1)"]),
        ("otlp_ratio = 2", "", &["--otlp-ratio is 2 (c.toml:1)"]),
        ("listen = \"0.0.0.0:0\"", "", &["other machines", "--insecure"]),
        ("ephemeral = true\ndata_dir = \"d\"", "", &["--ephemeral is given beside --data-dir (c.toml:1)"]),
        ("", "--ephemeral --data-dir d", &["--ephemeral is given beside --data-dir"]),
        ("max_streams = 8", "--max-streams=0", &["--max-streams is 0; it must be"]),
        ("store = \"postgres://h/d\"", "", &["--store is \"postgres://h/d\" (c.toml:1)", "beside --blobs s3://BUCKET"]),
    ] {
        write(file);
        for command in ["config check", "serve"] {
            let line = words(&format!("{command} --config c.toml {line}"));
            let state = [("XDG_STATE_HOME".to_owned(), folder.path().join("home").display().to_string())];
            let out = tessera(folder.path(), &line, &state);
            let told = text(&out.stderr);
            assert_eq!(out.status.code(), Some(2), "{line:?}: {told}");
            assert!(words_said.iter().all(|word| told.contains(word)), "{file}: {told}");
            assert!(out.stdout.is_empty());
        }
    }
    write("listen = \"0.0.0.0:0\"\nephemeral = true");
    let state = [("TESSERA_CONFIG".to_owned(), "c.toml".to_owned())];
    let out = tessera(folder.path(), &words("config check --insecure --ephemeral=false"), &state);
    assert_eq!(text(&out.stdout), "good\n", "{}", text(&out.stderr));
    // The command line is stronger than a variable, and a variable than the file.
    write("ephemeral = true");
    let data = ("TESSERA_DATA_DIR".to_owned(), "d".to_owned());
    for (line, variables) in [
        ("config check --config c.toml --data-dir d", vec![]),
        ("config check --config c.toml", vec![data.clone()]),
        ("config check --ephemeral", vec![data]),
    ] {
        let out = tessera(folder.path(), &words(line), &variables);
        assert_eq!(text(&out.stdout), "good\n", "{line}: {}", text(&out.stderr));
    }
    let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left, ["c.toml"], "no folder was made");
}

#[test]
fn the_password_of_a_database_is_not_printed() {
    let folder = tempfile::tempdir().unwrap();
    let line = words("config print --blobs s3://b --store postgres://me:secret@host/jobs");
    let out = tessera(folder.path(), &line, &[]);
    assert_eq!(printed(&out)["store"].0, "\"postgres://me@host/jobs\"", "{}", text(&out.stderr));
    let variable = ("TESSERA_STORE".to_owned(), "postgres://me:secret@host/jobs".to_owned());
    let help = tessera(folder.path(), &words("serve --help"), &[variable]);
    assert!(help.status.success() && !text(&help.stdout).contains("secret"));
}

/// The page of options names them all, with what they are if nobody says anything.
#[test]
fn the_page_of_options_is_what_there_is() {
    let page = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/configuration.md")).unwrap();
    let defaults = tessera(Path::new("."), &words("config print --defaults"), &[]);
    let mut known = printed(&defaults);
    known.extend(unset(&defaults).into_iter().map(|key| (key, (String::new(), String::new()))));
    let rows: Vec<(String, String)> = page
        .lines()
        .filter_map(|line| line.strip_prefix("| `--"))
        .map(|row| {
            let mut cells = row.split(" | ");
            let key = cells.next().unwrap().trim_end_matches('`').replace('-', "_");
            (key, cells.next().unwrap().to_owned())
        })
        .filter(|(key, _)| key != "config")
        .collect();
    let mut wrong = Vec::new();
    for (key, (value, _)) in &known {
        match rows.iter().find(|(row, _)| row == key) {
            None => wrong.push(format!("{} is missing", flag(key))),
            Some((_, shown)) if !value.is_empty() && shown != &format!("`{}`", plain(value)) => {
                wrong.push(format!("{} is {value}, the page says {shown}", flag(key)));
            }
            Some((_, shown)) if value.is_empty() && shown.starts_with('`') && !shown.contains(' ') => {
                wrong.push(format!("{} has no default, the page says {shown}", flag(key)));
            }
            Some(_) => {}
        }
    }
    wrong.extend(rows.iter().filter(|(key, _)| !known.contains_key(key)).map(|(key, _)| format!("there is no {key}")));
    assert!(wrong.is_empty(), "docs/configuration.md:\n{}", wrong.join("\n"));
}
