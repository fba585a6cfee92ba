//! `tessera blobs`.
//!
//! Purpose: files to and from a server, under the SHA-256 of their bytes. Invariant: the standard output has the digest or the
//! size and nothing else. Must not know: what the bytes mean.

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, Subcommand};
use serde_json::json;

use super::jobs::{digest, transfer};
use super::remote::session;
use super::server::ServerArgs;
use super::source::Source;
use super::{files, say};

/// `tessera blobs`' options.
#[derive(Args, Debug)]
pub(crate) struct BlobsArgs {
    #[command(subcommand)]
    command: BlobsCommand,
    #[command(flatten)]
    server: ServerArgs,
}

#[derive(Debug, Subcommand)]
enum BlobsCommand {
    /// Store a file, and print its digest.
    Put {
        /// The file.
        file: PathBuf,
    },
    /// Fetch a blob.
    Get {
        /// The SHA-256 of its bytes.
        #[arg(value_parser = digest)]
        digest: String,
        /// Where it goes. A file that is there is replaced once the new one is whole.
        #[arg(long, short, value_name = "FILE")]
        output: PathBuf,
    },
    /// Print the size of a blob in bytes; exit code 66 if it is not stored.
    Stat {
        /// The SHA-256 of its bytes.
        #[arg(value_parser = digest)]
        digest: String,
    },
}

/// Runs it.
pub(crate) fn run(args: &BlobsArgs) -> Result<()> {
    let (server, at) = (&args.server, args.server.server()?);
    match &args.command {
        BlobsCommand::Put { file } => {
            let sources = [Source::open(file)?];
            let progress = transfer(Some(file), server, "upload");
            let sent = session(&at, server.retry(), async |session| session.upload(&sources, &progress).await);
            drop(progress);
            let sent = sent?;
            let [source] = sources;
            match server.json {
                true => {
                    let (digest, size) = (source.digest(), source.size());
                    say::json(&json!({ "digest": digest, "size_bytes": size, "uploaded_bytes": sent }))?;
                }
                false => outln!("{}", source.digest())?,
            }
        }
        BlobsCommand::Get { digest, output } => {
            files::check_output(output, &[])?;
            let progress = transfer(Some(output), server, "download");
            let mut file = files::Output::begin(output)?;
            let fetched = session(&at, server.retry(), async |session| {
                session.download(digest, &mut |bytes| file.add(bytes), &progress).await
            });
            drop(progress);
            let size = fetched?;
            file.finish()?;
            if server.json {
                say::json(&json!({ "digest": digest, "size_bytes": size, "file": output.to_string_lossy() }))?;
            }
        }
        BlobsCommand::Stat { digest } => {
            let size = session(&at, server.retry(), async |session| session.stat(digest).await)?;
            match server.json {
                true => say::json(&json!({ "digest": digest, "size_bytes": size }))?,
                false => outln!("{size}")?,
            }
        }
    }
    Ok(())
}
