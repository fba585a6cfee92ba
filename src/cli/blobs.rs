//! `tessera blobs`.
//!
//! Purpose: files to and from a server, under the SHA-256 of their bytes. Invariant: the standard output has the digest or the
//! size and nothing else. Must not know: what the bytes mean.

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, Subcommand};
use serde_json::json;

use super::files;
use super::jobs::{digest, transfer};
use super::remote::{Session, session};
use super::server::ServerArgs;
use super::source::Source;

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

pub(crate) fn run(args: &BlobsArgs) -> Result<()> {
    let server = &args.server;
    // Before a file is read.
    server.at.url()?;
    match &args.command {
        BlobsCommand::Put { file } => {
            let source = Source::open(file)?;
            let (digest, size) = (source.digest.clone(), source.size);
            let progress = transfer(Some(file), server, "upload");
            let sent = session(server, async |session| session.upload(&[source], &progress).await);
            drop(progress);
            let json = |sent| json!({ "digest": digest, "size_bytes": size, "uploaded_bytes": sent });
            let sent = sent?;
            server.tell(|| json(sent), || vec![digest.clone()])
        }
        BlobsCommand::Get { digest, output } => {
            files::check_output(output, &[])?;
            let progress = transfer(Some(output), server, "download");
            let mut file = files::Output::begin(output)?;
            let fetch = async |session: &mut Session<'_>| {
                session.download(digest, &mut |bytes| file.add(bytes), &progress).await
            };
            let fetched = session(server, fetch);
            drop(progress);
            let size = fetched?;
            file.finish()?;
            let json = || json!({ "digest": digest, "size_bytes": size, "file": output.to_string_lossy() });
            server.tell(json, Vec::new)
        }
        BlobsCommand::Stat { digest } => {
            let size = session(server, async |session| session.stat(digest).await)?;
            server.tell(|| json!({ "digest": digest, "size_bytes": size }), || vec![size.to_string()])
        }
    }
}
