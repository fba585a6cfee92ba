//! The configuration of a server, and its validation.
//!
//! Purpose: [`ServeArgs`] holds the values of the file, the environment and the command line, in rising precedence;
//! [`ServeConfig`] is the checked result. One struct describes every option; a key of the file becomes the default of its
//! option, so that parsers, messages and precedence exist once. Invariant: a `ServeConfig` exists only if every value is
//! usable; it is made before any port is bound. Must not know: the use of a value, any other room.
mod args;
mod check;
mod file;
mod limits;
mod options;
mod security;
mod values;
pub use args::{BackendArg, BackendArgs, OnLoss, RoleArg, ServeArgs};
pub use check::{ServeConfig, data_dir};
pub use file::{ConfigFile, FileError, sources};
pub use limits::Limits;
pub use options::{defaults, print, with_switches};
pub use security::SecurityArgs;
pub use values::{ConfigError, count, period, whole};
#[cfg(test)]
mod tests {
    use std::net::SocketAddr;
    use std::time::Duration;

    use clap::Parser;

    use super::values::{count, period};
    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        serve: ServeArgs,
    }

    fn parse(line: &[&str]) -> Result<ServeConfig, ConfigError> {
        Line::try_parse_from([&["tessera"], line].concat()).unwrap().serve.check()
    }

    #[test]
    fn the_defaults_are_the_library_s() {
        assert_eq!(parse(&[]).unwrap().limits, Limits::default());
    }

    #[test]
    fn numbers_are_taken_as_people_write_them() {
        for (text, number) in [
            ("10000", 10_000),
            ("1e4", 10_000),
            ("10k", 10_000),
            ("10,000", 10_000),
            ("2.5e3", 2500),
            ("7.0", 7),
            ("+3", 3),
        ] {
            assert_eq!((whole(text), count(text)), (Ok(number), Ok(number as u32)), "{text}");
        }
        assert_eq!(whole("18446744073709551615"), Ok(u64::MAX));
        assert_eq!((whole("0"), count("0").is_err()), (Ok(0u32), true));
        for text in ["", "1.5", "-1", "1e-3", "1e400", "inf", "nan", "10q", "10,00", "0x10", "5000000000", "1e20"] {
            assert!(whole::<u32>(text).is_err() && count(text).is_err(), "{text}");
        }
    }

    #[test]
    fn names_are_resolved() {
        let here: SocketAddr = "127.0.0.1:50051".parse().unwrap();
        assert_eq!(parse(&[]).unwrap().listen, [here]);
        assert!(parse(&["--listen", "localhost:50051"]).unwrap().listen[0].ip().is_loopback());
        assert_eq!(parse(&["--listen", "[::1]:0"]).unwrap().listen, ["[::1]:0".parse().unwrap()]);
        for bad in [
            "",
            "50051",
            ":50051",
            "localhost",
            "localhost:",
            "localhost:x",
            "127.0.0.1:65536",
            "http://localhost:1",
            "::1",
        ] {
            assert_eq!(parse(&["--listen", bad]).unwrap_err().option, "--listen", "{bad}");
        }
        assert!(parse(&["--listen", "no such name:1"]).is_err());
    }

    #[test]
    fn the_http_door_is_shut_and_has_the_rule_of_the_other() {
        assert!(parse(&[]).unwrap().http.is_empty());
        let http = |address| parse(&["--http-listen", address]);
        assert_eq!(http("127.0.0.1:8080").unwrap().http, ["127.0.0.1:8080".parse().unwrap()]);
        assert_eq!(http("0.0.0.0:8080").unwrap_err().option, "--http-listen");
        assert_eq!(http("8080").unwrap_err().option, "--http-listen");
        assert!(parse(&["--http-listen", "0.0.0.0:8080", "--insecure"]).is_ok());
    }

    #[test]
    fn a_bucket_has_a_name() {
        for bad in ["", "bucket", "s3://", "s3:///prefix", "gs://bucket", "https://host/bucket"] {
            assert_eq!(parse(&["--blobs", bad]).unwrap_err().option, "--blobs", "{bad}");
        }
        assert!(parse(&["--blobs", "s3://b", "--ephemeral"]).is_err());
        #[cfg(feature = "s3")]
        assert_eq!(parse(&["--blobs", "s3://b/p"]).unwrap().bucket.as_deref(), Some("s3://b/p"));
    }

    #[test]
    fn a_database_needs_a_bucket_and_its_password_is_not_repeated() {
        let url = "postgres://me:secret@host/jobs";
        for line in [
            &["--store", url][..],
            &["--store", url, "--blobs", "s3://b", "--ephemeral"],
            &["--store", "mysql://me:secret@host/jobs", "--blobs", "s3://b"],
            &["--store", "postgres://me@host/jobs?password=secret", "--blobs", "s3://b"],
            &["--store", "secret", "--blobs", "s3://b", "--store-password-file", "f"],
        ] {
            let error = parse(line).unwrap_err();
            assert_eq!(error.option, if line.contains(&"--ephemeral") { "--blobs" } else { "--store" });
            assert!(line[1] == "secret" || !error.to_string().contains("secret"), "{error}");
        }
        assert_eq!(parse(&["--store-password-file", "f"]).unwrap_err().option, "--store-password-file");
        #[cfg(all(feature = "postgres", feature = "s3"))]
        assert_eq!(parse(&["--store", url, "--blobs", "s3://b"]).unwrap().database, Some((url.to_owned(), None)));
    }

    #[test]
    fn times_are_taken_with_their_unit() {
        for (text, seconds) in [("90s", 90.0), ("1.5m", 90.0), ("24h", 86_400.0), ("7d", 604_800.0), ("0s", 0.0)] {
            assert_eq!(period(text), Ok(Duration::from_secs_f64(seconds)), "{text}");
        }
        for text in ["", "7", "d", "-1s", "1w", "1 h", "nans", "infd", "1e20d", "5µ"] {
            assert!(period(text).is_err(), "{text}");
        }
    }

    #[test]
    fn what_makes_no_sense_is_named() {
        for line in [["--queue-jobs", "0"], ["--grace-s", "NaN"], ["--max-seeds", "4294967296"], ["--threads", "0"]] {
            assert_eq!(parse(&line).unwrap_err().option, line[0]);
        }
        assert!(parse(&["--ephemeral", "--data-dir", "x"]).is_err());
    }
}
