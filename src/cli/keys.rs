//! `tessera keys`.
//!
//! Purpose: makes, lists and revokes the keys of a server, in its folder, or of servers that share a database, there. Invariant: a key is printed once, on the standard
//! output, when it is made; nothing else prints it. It works while the server runs, which sees the change within a few seconds.
//! Must not know: servers, how keys are kept.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::Result;
use clap::{Args, Subcommand};
use prost_types::Timestamp;
use serde_json::{Value, json};

#[cfg(feature = "postgres")]
use super::cluster::DatabaseArgs;
use super::exit::{Absent, BadInput, NotWritten, Unavailable, Usage};
use super::say;
use super::server::number;
#[cfg(feature = "postgres")]
use jobs::postgres::{Operator, PostgresOptions};
pub(crate) use server::config::{data_dir, period, whole};
use server::keys::{Key, KeyFile, KeyLimits, KeySet, KeysError, NewKey, Role, now};
#[cfg(feature = "postgres")]
use server::keys::{change_shared, read_shared};

#[derive(Args, Debug)]
pub(crate) struct KeysArgs {
    #[command(subcommand)]
    command: KeysCommand,
    /// The server's folder, as `tessera serve` has it: the user's state directory if not given.
    #[arg(long, value_name = "DIR", global = true, env = "TESSERA_DATA_DIR")]
    data_dir: Option<PathBuf>,
    #[cfg(feature = "postgres")]
    #[command(flatten)]
    database: DatabaseArgs,
    /// Print the answer as JSON.
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Debug, Subcommand)]
enum KeysCommand {
    /// Make a key, and print it: it is shown this once.
    Add(AddArgs),
    /// List the keys: ids, names, roles and limits. No key can be shown again.
    List,
    /// Revoke the keys of a name, or one key by its id. Calls that are open with it end.
    Revoke {
        /// The name, or the id.
        name: String,
    },
}

#[derive(Args, Debug)]
struct AddArgs {
    /// Whose key it is. Jobs and blobs belong to this name.
    name: String,
    /// What it may do: `read` asks about its own jobs and blobs, `submit` also creates and ends them, `admin` does so in
    /// anybody's name.
    #[arg(long, value_name = "ROLE")]
    role: Role,
    /// When it ends, e.g. 12h or 90d; never if not given.
    #[arg(long, value_name = "TIME", value_parser = lasting)]
    expires: Option<Duration>,
    /// Calls a second.
    #[arg(long, value_name = "N", value_parser = whole::<u32>)]
    rate: Option<u32>,
    /// Calls that may be open at once: streams, uploads, downloads, watches and questions.
    #[arg(long, value_name = "N", value_parser = whole::<u32>)]
    in_flight: Option<u32>,
    /// Bytes of blobs that its name may have, uploads included. Results count, and are kept all the same.
    #[arg(long, value_name = "N", value_parser = whole::<u64>)]
    bytes: Option<u64>,
    /// Its share of the work beside others, 0.01 to 100; 1 if not given.
    #[arg(long, value_name = "N", value_parser = weight)]
    weight: Option<f64>,
    /// Make a second key for a name that has one: use it, then revoke the old one by its id.
    #[arg(long)]
    rotate: bool,
}

fn lasting(text: &str) -> Result<Duration, String> {
    let time = period(text)?;
    if time < Duration::from_secs(1) { Err("a key lasts a second at least".to_owned()) } else { Ok(time) }
}

fn weight(text: &str) -> Result<f64, String> {
    number(text, 0.01..=100.0, "a number from 0.01 to 100 is needed")
}

/// Where the keys are.
enum Place {
    File(KeyFile),
    #[cfg(feature = "postgres")]
    Database(PostgresOptions),
}

impl Place {
    fn of(args: &KeysArgs) -> Result<Self> {
        #[cfg(feature = "postgres")]
        if args.database.is_given() {
            return Ok(Self::Database(args.database.options()?));
        }
        Ok(Self::File(KeyFile::in_folder(data_dir(args.data_dir.as_ref())?)))
    }

    fn read(&self) -> Result<KeySet> {
        match self {
            Self::File(file) => file.read(),
            #[cfg(feature = "postgres")]
            Self::Database(options) => super::cluster::run(async { read_shared(&operator(options).await?).await })?,
        }
        .map_err(told)
    }

    fn change<R>(&self, change: impl FnMut(&mut KeySet) -> Result<R, KeysError>) -> Result<R> {
        match self {
            Self::File(file) => file.change(change),
            #[cfg(feature = "postgres")]
            Self::Database(options) => {
                super::cluster::run(async { change_shared(&operator(options).await?, change).await })?
            }
        }
        .map_err(told)
    }
}

#[cfg(feature = "postgres")]
async fn operator(options: &PostgresOptions) -> Result<Operator, KeysError> {
    Operator::connect(options).await.map_err(|error| KeysError::Shared(error.to_string()))
}

pub(crate) fn run(args: &KeysArgs) -> Result<()> {
    let place = Place::of(args)?;
    match &args.command {
        KeysCommand::Add(add) => {
            let &AddArgs { role, expires: lasts, rate, in_flight, bytes, weight, rotate: is_second, .. } = add;
            let limits = KeyLimits { rate, in_flight, bytes, weight };
            let new = NewKey { name: add.name.clone(), role, lasts, limits, is_second };
            let (key, secret) = place.change(|keys| keys.add(new.clone()))?;
            let shown = match args.json {
                true => {
                    let mut told = json_of(&key);
                    told["key"] = secret.reveal().into();
                    say::try_line(format_args!("{told:#}"))
                }
                false => say::try_line(format_args!("{}", secret.reveal())),
            };
            // It was not printed, and cannot be shown again.
            if !matches!(shown, Ok(true)) {
                place.change(|keys| keys.revoke(&key.id))?;
                shown?;
                return Err(NotWritten("the key could not be printed; it was not made".to_owned()).into());
            }
            if !args.json {
                let name = &key.name;
                errln!("tessera: this is the key of {name}, shown this once; keep it where only its user can read it");
            }
            Ok(())
        }
        KeysCommand::List => show(args, place.read()?.keys()),
        KeysCommand::Revoke { name } => show(args, &place.change(|keys| keys.revoke(name))?),
    }
}

fn show(args: &KeysArgs, keys: &[Key]) -> Result<()> {
    match args.json {
        true => say::json(&Value::Array(keys.iter().map(json_of).collect()))?,
        false => keys.iter().try_for_each(|key| outln!("{}", line(key)))?,
    }
    Ok(())
}

/// With the exit code of its kind.
fn told(error: KeysError) -> anyhow::Error {
    let text = error.to_string();
    match error {
        KeysError::Damaged { .. } => BadInput(text).into(),
        KeysError::Shared(_) => Unavailable(text).into(),
        KeysError::Io { .. } | KeysError::Random(_) => NotWritten(text).into(),
        KeysError::Absent { .. } => Absent(text).into(),
        KeysError::Exists { .. } | KeysError::Name { .. } | KeysError::Limits | KeysError::TooMany => {
            Usage(text).into()
        }
    }
}

fn moment(seconds: u64) -> String {
    i64::try_from(seconds).map_or_else(|_| "never".to_owned(), |seconds| Timestamp { seconds, nanos: 0 }.to_string())
}

fn line(key: &Key) -> String {
    let KeyLimits { rate, in_flight, bytes, weight } = key.limits;
    let mut line = format!("{}  {:16} {:6}  made {}", key.id, key.name, key.role.name(), moment(key.created));
    if let Some(end) = key.expires {
        let word = if key.is_expired(now()) { "ended" } else { "ends" };
        line += &format!("  {word} {}", moment(end));
    }
    let limits = [
        rate.map(|n| format!("  rate {n}")),
        in_flight.map(|n| format!("  in-flight {n}")),
        bytes.map(|n| format!("  bytes {n}")),
        weight.map(|n| format!("  weight {n}")),
    ];
    line + &limits.into_iter().flatten().collect::<String>()
}

fn json_of(key: &Key) -> Value {
    let KeyLimits { rate, in_flight, bytes, weight } = key.limits;
    json!({
        "id": key.id,
        "name": key.name,
        "role": key.role.name(),
        "created": moment(key.created),
        "expires": key.expires.map(moment),
        "expired": key.is_expired(now()),
        "rate": rate,
        "in_flight": in_flight,
        "bytes": bytes,
        "weight": weight,
    })
}
