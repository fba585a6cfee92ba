//! `tessera load`: puts a server under load and measures how it answers.
//!
//! Purpose: the options of a load, and what came of it to a table, JSON, a picture and an exit code.
//! Invariant: what cannot be written or asked for is refused before the first call. A report is given however the run ends.
//! Must not know: what is in a call (`calls`), when it is made (`clients`).

mod amounts;
mod calls;
mod clients;
mod compare;
mod measure;
mod meshes;
mod report;
mod thresholds;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use anyhow::{Context, Result};
use clap::{ArgGroup, Args, ValueEnum};
use hyper::Uri;
use serde_json::{Value, json};
use tokio::sync::watch;

use self::amounts::{Kind, Mix, Points, Sizes};
use self::calls::{Caller, delete_blob, put};
use self::clients::{Doors, Ran};
use self::compare::{Comparison, Samples};
use self::measure::Measure;
use self::meshes::Surface;
use self::report::{QUANTILES, View};
use self::thresholds::Threshold;
use super::exit::{self, Crossed, Unavailable, Usage};
use super::remote::{self, Door, Line, Windows};
use super::server::{CallArgs, Server, Tenant, number, pause};
use super::{files, info, interrupt};
use geometry::mesh::shapes::Shape;
use geometry::rvd::RvdError;
use geometry::token::Stopped;
use picture::Size;
pub(crate) use server::config::{BackendArg, count};
use wire::proto::GetServerInfoResponse;

#[derive(Args, Clone, Debug)]
#[command(group(ArgGroup::new("loop").required(true).args(["clients", "rate"])))]
pub(crate) struct LoadArgs {
    /// Closed loop: number of clients, each of which calls again once it has its answer.
    #[arg(long, value_name = "N", value_parser = clients, help_heading = "Load")]
    clients: Option<u32>,
    /// Open loop: calls a second, at random times (Poisson), whatever the server does.
    #[arg(long, value_name = "R", value_parser = rate, help_heading = "Load")]
    rate: Option<f64>,
    /// Seconds to measure.
    #[arg(long, value_name = "S", value_parser = length, help_heading = "Load")]
    duration_s: Duration,
    /// Seconds before that which are not measured.
    #[arg(long, value_name = "S", default_value = "0", value_parser = span, help_heading = "Load")]
    warm_up_s: Duration,
    /// Seconds before the warm-up in which the rate, or the number of clients, rises from 0.
    #[arg(long, value_name = "S", default_value = "0", value_parser = span, help_heading = "Load")]
    ramp_s: Duration,
    /// Open loop: the most calls that are open. One more is not sent and counted as dropped.
    #[arg(long, value_name = "N", default_value_t = 512, value_parser = clients, conflicts_with = "clients", help_heading = "Load")]
    max_in_flight: u32,
    /// Connections; not set: one for every 8 clients or 64 open calls, at most 64.
    #[arg(long, value_name = "N", value_parser = connections, help_heading = "Load")]
    connections: Option<u32>,
    /// Seconds that a call may take. Then it is cancelled and counted as an error.
    #[arg(long, value_name = "S", default_value = "120", value_parser = length, help_heading = "Load")]
    timeout_s: Duration,

    /// Kinds of calls with their weights, e.g. remesh-job=4,remesh=1. Streams are remesh, rvd and cvt; jobs are remesh-job
    /// and rvd-job; info is GetServerInfo.
    #[arg(long, value_name = "MIX", default_value = "remesh-job", help_heading = "Calls")]
    mix: Mix,
    /// A surface to send; may be given several times.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["facets", "shape"], help_heading = "Calls")]
    mesh: Vec<PathBuf>,
    /// Facets of made surfaces: 10000, or 1000..20000 for 16 sizes, each power of ten as likely as the next.
    #[arg(long, value_name = "N", default_value = "10000", help_heading = "Calls")]
    facets: Sizes,
    /// The shape of made surfaces, as of `tessera shape`.
    #[arg(long, value_name = "SHAPE", default_value_t = Shape::Genus(3), help_heading = "Calls")]
    shape: Shape,
    /// Points to ask for: a number, or a part of the facets and at least 100.
    #[arg(long, value_name = "N", default_value = "10%", help_heading = "Calls")]
    points: Points,
    /// Lloyd steps of a remesh; not set: as the server does.
    #[arg(long, value_name = "N", help_heading = "Calls")]
    lloyd: Option<u32>,
    /// Quasi-Newton steps of a remesh; not set: as the server does.
    #[arg(long, value_name = "N", help_heading = "Calls")]
    newton: Option<u32>,
    /// Which backend of the server should do the work.
    #[arg(long, value_enum, default_value_t, help_heading = "Calls")]
    backend: BackendArg,
    /// Whether each job uploads a file of its own, or all use files that are uploaded once.
    #[arg(long, value_enum, default_value_t, help_heading = "Calls")]
    upload: UploadArg,
    /// Percent of the calls that are cancelled, at a random time.
    #[arg(long, value_name = "PERCENT", default_value = "0", value_parser = percent, help_heading = "Calls")]
    cancel: f64,
    /// Clients beside the others that read their results slowly.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = slow_readers, help_heading = "Calls")]
    slow_readers: u32,
    /// Bytes a second that each of them reads.
    #[arg(long, value_name = "BYTES", default_value_t = 65_536, value_parser = count, help_heading = "Calls")]
    slow_rate: u32,
    /// Tenants that the calls are of, in turn: NAME-0, NAME-1 and so on, with the NAME of --tenant, else load.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = connections, help_heading = "Calls")]
    tenants: u32,
    /// The same number gives the same plan: times, kinds, sizes, cancellations.
    #[arg(long, value_name = "N", default_value_t = 0, help_heading = "Calls")]
    seed: u64,
    /// Leave jobs and blobs at the server.
    #[arg(long, help_heading = "Calls")]
    keep: bool,

    /// The server's metrics, e.g. http://127.0.0.1:9090/metrics: its counts are compared with those here.
    #[arg(long, value_name = "URL", value_parser = compare::metrics_url, help_heading = "Results")]
    metrics: Option<Uri>,
    /// Exit code 79 if this holds, e.g. p99>2s, errors>0, refused>1%, rate<5, dropped>0; may be given several times.
    #[arg(long = "fail-if", value_name = "EXPR", value_delimiter = ',', help_heading = "Results")]
    fail_if: Vec<Threshold>,
    /// Write all figures there, as JSON.
    #[arg(long, value_name = "FILE.json", help_heading = "Results")]
    json: Option<PathBuf>,
    /// Draw latencies and outcomes over time there.
    #[arg(long, value_name = "FILE.png", help_heading = "Results")]
    plot: Option<PathBuf>,
    /// Show nothing while it runs, and no table.
    #[arg(long, short, help_heading = "Results")]
    quiet: bool,

    #[command(flatten)]
    at: CallArgs,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
enum UploadArg {
    /// Each job uploads a file that no server has.
    #[default]
    Each,
    /// Files are uploaded before the run.
    Once,
}

/// The most clients, and calls that are open.
const MOST: u32 = 10_000;

fn clients(text: &str) -> Result<u32, String> {
    count(text).ok().filter(|n| *n <= MOST).ok_or_else(|| format!("a whole number from 1 to {MOST} is needed"))
}

fn slow_readers(text: &str) -> Result<u32, String> {
    if text == "0" { Ok(0) } else { clients(text) }
}

fn connections(text: &str) -> Result<u32, String> {
    count(text).ok().filter(|n| *n <= 1000).ok_or_else(|| "a whole number from 1 to 1000 is needed".to_owned())
}

fn rate(text: &str) -> Result<f64, String> {
    number(text, 0.001..=100_000.0, "a number of calls a second from 0.001 to 100000 is needed")
}

fn percent(text: &str) -> Result<f64, String> {
    number(text.trim_end_matches('%'), 0.0..=100.0, "a number from 0 to 100 is needed")
}

fn span(text: &str) -> Result<Duration, String> {
    pause(text).map(Duration::from_secs_f64)
}

fn length(text: &str) -> Result<Duration, String> {
    let wrong = || "a number of seconds from 0.1 to 86400 is needed".to_owned();
    span(text).ok().filter(|length| *length >= Duration::from_millis(100)).ok_or_else(wrong)
}

pub(crate) fn run(args: &LoadArgs) -> Result<()> {
    args.check()?;
    let server = args.at.server()?;
    let surfaces = meshes::build(&args.mesh, args.shape, args.facets, args.points)?;
    let threads = std::thread::available_parallelism().map_or(2, usize::from).clamp(2, 8);
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(threads).enable_all().build();
    let done = runtime.context("no runtime")?.block_on(args.load(&server, surfaces))?;
    done.tell(args, &server)
}

impl LoadArgs {
    fn check(&self) -> Result<()> {
        if self.fail_if.iter().any(Threshold::needs_comparison) && self.metrics.is_none() {
            return Err(Usage("--fail-if 'mismatches>0' needs --metrics URL, whose counts are compared".into()).into());
        }
        if self.slow_readers > 0 && self.mix.only_those(Kind::is_work).is_none() {
            return Err(Usage("--slow-readers needs a kind of call with a result in --mix".into()).into());
        }
        self.json.iter().try_for_each(|path| files::check_output(path, &[]))?;
        self.plot.iter().try_for_each(|path| files::check_output(path, &["png"]))?;
        let outputs = [&self.json, &self.plot];
        let outputs = outputs.into_iter().flatten().map(PathBuf::as_path);
        files::check_apart(self.mesh.iter().map(PathBuf::as_path), outputs)
    }

    /// When measuring begins and ends, since the run began.
    fn window(&self) -> std::ops::Range<Duration> {
        let begin = self.ramp_s + self.warm_up_s;
        begin..begin + self.duration_s
    }

    /// The tenants that calls are of; one that the server takes us for is none.
    fn tenants(&self, server: &Server) -> Result<Vec<Option<Tenant>>> {
        if self.tenants == 1 {
            return Ok(vec![None]);
        }
        let name = server.tenant.as_ref().map_or("load", Tenant::as_str);
        let all = (0..self.tenants).map(|k| format!("{name}-{k}").parse().map(Some));
        all.collect::<Result<_, String>>().map_err(|why| Usage(format!("--tenants: {why}")).into())
    }

    /// Connects: one channel for each connection and tenant.
    async fn doors(&self, server: &Server) -> Result<Doors> {
        let wanted = match (self.clients, self.connections) {
            (_, Some(connections)) => connections,
            (Some(clients), None) => clients.div_ceil(8).clamp(1, 64),
            (None, None) => self.max_in_flight.div_ceil(64).clamp(1, 64),
        };
        let tenants = self.tenants(server)?;
        let mut lines = Vec::new();
        for _ in 0..wanted {
            lines.push(Line::open(server, Windows::Usual).await?);
        }
        let mut doors = Doors { usual: Vec::new(), slow: Vec::new() };
        for k in 0..lines.len().max(tenants.len()) {
            doors.usual.push(lines[k % lines.len()].door(tenants[k % tenants.len()].as_ref())?);
        }
        // What one does not read would hold up the others of its connection.
        for k in 0..self.slow_readers.min(64) as usize {
            let line = Line::open(server, Windows::Narrow).await?;
            doors.slow.push(line.door(tenants[k % tenants.len()].as_ref())?);
        }
        Ok(doors)
    }

    async fn load(&self, server: &Server, surfaces: Vec<Surface>) -> Result<Done> {
        let signals = interrupt::signals().context("cannot listen for signals")?;
        let doors = self.doors(server).await?;
        let info = match remote::info(server, Duration::from_secs(10)).await {
            Ok(info) => Some(info),
            // An older server, or one whose key may not ask.
            Err(error) if exit::code(&error) != exit::code(&Unavailable(String::new()).into()) => None,
            Err(error) => return Err(error),
        };
        let before = match &self.metrics {
            Some(url) => Some(compare::settled(url).await?),
            None => None,
        };
        let (stop, stopped) = watch::channel(false);
        let args = Arc::new(self.clone());
        let facets: Vec<u64> = surfaces.iter().map(|surface| surface.facets).collect();
        let caller = Arc::new(Caller::new(Arc::clone(&args), surfaces, name(), stopped));
        let uploaded = self.upload(&caller, &doors).await?;
        let view = View::new(self.window().end, self.quiet);
        // Kept until the end: without the sender a run cannot be stopped.
        let stopper = tokio::spawn(async move {
            let _ = signals.await;
            let _ = stop.send(true);
            std::future::pending::<()>().await;
        });
        let Ran { measure, mut left, stopped } = clients::run(Arc::clone(&caller), doors, args, view).await;
        for (door, digest) in uploaded.iter().filter(|_| !self.keep) {
            left += u64::from(!delete_blob(&caller.tally, door, digest).await);
        }
        stopper.abort();
        let comparison = match (&self.metrics, before) {
            (Some(url), Some(before)) => Some(compare(url, &before, &caller).await?),
            _ => None,
        };
        Ok(Done { measure, comparison, info, left, stopped, facets, run: caller.run.clone() })
    }

    /// Uploads the files of jobs, if all jobs share them; those that were not there.
    async fn upload(&self, caller: &Caller, doors: &Doors) -> Result<Vec<(Door, String)>> {
        let mut uploaded = Vec::new();
        if self.upload == UploadArg::Each || !self.mix.parts().any(|(kind, _)| kind.is_job()) {
            return Ok(uploaded);
        }
        for door in doors.usual.iter().take(self.tenants as usize) {
            for surface in caller.surfaces.iter() {
                let stored = put(&caller.tally, door, surface, self.timeout_s).await;
                let is_new = stored.map_err(|status| {
                    let said = super::say::plain(status.message());
                    Unavailable(format!("the surfaces cannot be uploaded; the server says: {said}"))
                })?;
                if is_new {
                    uploaded.push((door.clone(), surface.digest.clone()));
                }
            }
        }
        Ok(uploaded)
    }

    fn title(&self) -> String {
        let how = match (self.clients, self.rate) {
            (_, Some(rate)) => format!("open loop, {rate} calls a second"),
            (clients, None) => format!("closed loop, {} clients", clients.unwrap_or(1)),
        };
        format!("{how}, {} s; {}", self.duration_s.as_secs_f64(), self.mix)
    }

    fn options(&self) -> Value {
        json!({
            "clients": self.clients, "rate": self.rate, "duration_s": self.duration_s.as_secs_f64(),
            "warm_up_s": self.warm_up_s.as_secs_f64(), "ramp_s": self.ramp_s.as_secs_f64(),
            "max_in_flight": self.max_in_flight, "connections": self.connections,
            "timeout_s": self.timeout_s.as_secs_f64(), "mix": self.mix.to_string(),
            "meshes": self.mesh.iter().map(|path| path.display().to_string()).collect::<Vec<_>>(),
            "facets": self.facets.to_string(), "shape": self.shape.to_string(), "points": self.points.to_string(),
            "lloyd": self.lloyd, "newton": self.newton, "cancel_percent": self.cancel,
            "upload": if self.upload == UploadArg::Each { "each" } else { "once" },
            "slow_readers": self.slow_readers, "slow_rate": self.slow_rate, "tenants": self.tenants,
            "seed": self.seed, "fail_if": self.fail_if.iter().map(ToString::to_string).collect::<Vec<_>>(),
        })
    }
}

struct Done {
    measure: Measure,
    comparison: Option<Comparison>,
    info: Option<GetServerInfoResponse>,
    left: u64,
    stopped: bool,
    facets: Vec<u64>,
    run: String,
}

impl Done {
    /// Prints and writes the report; the error says what went wrong.
    fn tell(&self, args: &LoadArgs, server: &Server) -> Result<()> {
        let counts = &self.measure.counts;
        let crossed: Vec<String> =
            args.fail_if.iter().filter_map(|t| t.crossed(|figure| self.figure(figure), counts.intended)).collect();
        if let Some(path) = &args.json {
            let mut all = json!({
                "endpoint": server.url.as_str(), "run": self.run, "client_version": env!("CARGO_PKG_VERSION"),
                "options": args.options(), "server": self.info.as_ref().map(info::as_json),
            });
            if let (Some(all), Value::Object(figures)) = (all.as_object_mut(), self.json(&crossed)) {
                all.extend(figures);
            }
            files::write_json(path, &all)?;
        }
        if let Some(path) = &args.plot {
            let figure = report::figure(args.title(), &self.measure);
            figure.write(Size::new(1600, 600)?, path).with_context(|| format!("cannot draw {}", path.display()))?;
        }
        if !args.quiet {
            outln!("{}\nserver     {}\nsurfaces   {}", args.title(), self.server(server), self.surfaces(args))?;
            self.lines(&crossed).iter().try_for_each(|line| outln!("{line}"))?;
        }
        let lost = counts.failed.get("CONNECTION_LOST").map_or(0, |times| times.count);
        if self.stopped {
            return Err(anyhow::Error::from(RvdError::Stopped(Stopped::Cancelled)).context("the load was ended early"));
        }
        if counts.done == 0 && lost > 0 {
            let text = format!("{} went away: {lost} calls lost their connection, and none was done", server.url);
            return Err(Unavailable(text).into());
        }
        let wrong = || Crossed(format!("thresholds were crossed: {}", crossed.join("; "))).into();
        crossed.is_empty().then_some(()).ok_or_else(wrong)
    }

    fn figure(&self, name: &str) -> Option<f64> {
        let (measure, counts) = (&self.measure, &self.measure.counts);
        let count = match name {
            "max" => return measure.latencies.max(),
            "mean" => return measure.latencies.mean(),
            "rate" => return Some(measure.rate(measure.amounts.done)),
            "errors" => counts.errors(),
            "refused" => counts.refusals(),
            "dropped" => counts.dropped,
            "late" => counts.late,
            "cancelled" => counts.cancelled,
            "mismatches" => self.comparison.as_ref()?.mismatches(),
            quantile => {
                let (_, part) = QUANTILES.into_iter().find(|(name, _)| *name == quantile)?;
                return measure.latencies.quantile(part);
            }
        };
        Some(count as f64)
    }

    fn server(&self, server: &Server) -> String {
        let Some(info) = &self.info else { return server.url.to_string() };
        let usual = info.backends.iter().find(|backend| backend.is_default);
        let backend = usual.map(|b| format!(", {}, {} threads", b.name, b.threads)).unwrap_or_default();
        super::say::plain(&format!("{}, version {}{backend}", server.url, info.version))
    }

    fn surfaces(&self, args: &LoadArgs) -> String {
        let (least, most) = (self.facets.iter().min().unwrap_or(&0), self.facets.iter().max().unwrap_or(&0));
        let of = if args.mesh.is_empty() { args.shape.to_string() } else { "files".to_owned() };
        let sizes = if least == most { format!("{least}") } else { format!("{least} to {most}") };
        let points = match args.points {
            Points::Count(points) => format!("{points} points"),
            Points::Part(part) => format!("points for {:.3} % of them", 100.0 * part),
        };
        format!("{} of {of}, {sizes} facets, {points}", self.facets.len())
    }
}

/// The server's counts, once it has counted what was given up as well.
async fn compare(url: &Uri, before: &Samples, caller: &Caller) -> Result<Comparison> {
    const PAUSE: Duration = Duration::from_millis(100);
    /// Looks for counts that are equal, and for all of those that were given up.
    const LOOKS: (u32, u32) = (50, 10);
    let methods = caller.tally.methods();
    let mut looks = 0;
    loop {
        let comparison = Comparison::of(&methods, before, &compare::read(url).await?);
        let (equal, whole) = (comparison.mismatches() == 0, comparison.is_whole());
        looks += 1;
        if (equal && (whole || looks >= LOOKS.1)) || looks >= LOOKS.0 {
            return Ok(comparison);
        }
        tokio::time::sleep(PAUSE).await;
    }
}

/// A name that no other run has.
fn name() -> String {
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    format!("{:x}-{:x}", now.as_millis(), std::process::id())
}
