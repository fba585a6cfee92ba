//! Authentication, roles and rate limits of calls.
//!
//! Purpose: [`Access`] looks at each request before any service does: its key, its role, its tenant, its rate. [`Guarded`] are
//! the services behind it. Invariant: there is no other way to a service. Every request without a good key is refused in the
//! same words, after the same work. What a key may do is written in `methods`; a method that is not there is not served.
//! A key that is revoked or ends takes its open calls with it. Secrets are taken out of a request here, and go nowhere.
//! Must not know: messages, connections, what a tenant has.

mod methods;
mod table;

use std::fmt;
use std::path::Path;
use std::sync::{Arc, PoisonError, RwLock, RwLockReadGuard};
use std::time::Duration;

use tokio::net::TcpListener;
use tokio::task::JoinSet;
use tonic::Status;
use tonic::body::Body;
use tonic::codegen::Service as _;
use tonic::codegen::http::{HeaderMap, HeaderValue, Method, Request, Response, StatusCode, Version, header};
use tonic::service::Routes;

use self::methods::Needs;
pub(super) use self::methods::served;
use self::table::Held;
pub(crate) use self::table::Pass;
use self::table::Table;
use super::RequestError;
use crate::hosts::{self, Foreign, Hosts, Reach};
use crate::keys::{DOCUMENT, KeyFile, KeySet, KeysError, Role, Secret, Stamp, now, of_document};
use jobs::Weights;
use jobs::executor::api::JobApi;
use jobs::store::JobStore;
use telemetry::Seldom;

/// The metadata that names the tenant.
pub(super) const TENANT: &str = "tessera-tenant";

/// Between two looks whether the file of the keys has changed or a key has ended.
const LOOK_EVERY: Duration = Duration::from_secs(1);

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AccessOptions {
    pub require_keys: bool,
    pub reflection: bool,
    pub health_needs_key: bool,
    /// What a server without keys answers besides its own addresses.
    pub hosts: Hosts,
}

impl Default for AccessOptions {
    fn default() -> Self {
        Self { require_keys: false, reflection: true, health_needs_key: false, hosts: Hosts::default() }
    }
}

/// See the module's head. Clones share one table.
#[derive(Clone)]
pub struct Access {
    shared: Arc<Shared>,
    /// The hosts of requests by this listener.
    reach: Reach,
}

struct Shared {
    options: AccessOptions,
    home: Option<Home>,
    table: RwLock<Table>,
    log: Seldom,
}

impl fmt::Debug for Access {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Access").field("options", &self.shared.options).finish_non_exhaustive()
    }
}

/// Where the keys are.
#[derive(Clone)]
enum Home {
    File(KeyFile),
    /// A store that several servers share.
    Store(Arc<dyn JobStore>),
}

/// By which a change of the keys is seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Seen {
    File(Stamp),
    /// The document's version; none if it is not there.
    Version(Option<i64>),
}

impl Home {
    /// The keys, if they have changed since. What changes meanwhile is seen at the next look.
    async fn look(&self, before: Option<Seen>) -> Option<(Option<Seen>, Result<KeySet, KeysError>)> {
        match self {
            Self::File(file) => {
                let file = file.clone();
                let looked = tokio::task::spawn_blocking(move || {
                    // The stamp first.
                    let stamp = Seen::File(file.stamp());
                    (before != Some(stamp)).then(|| (Some(stamp), file.read()))
                });
                looked.await.unwrap_or_else(|error| Some((None, Err(KeysError::Shared(error.to_string())))))
            }
            Self::Store(store) => match store.shared()?.document(DOCUMENT).await {
                Ok(document) => {
                    let version = Seen::Version(document.as_ref().map(|document| document.version));
                    (before != Some(version)).then(|| (Some(version), of_document(document.as_ref())))
                }
                Err(error) => Some((before, Err(KeysError::Shared(error.to_string())))),
            },
        }
    }
}

/// Why a request is refused before any service sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    // The same in every case: none, no key at all, unknown, wrong, revoked, over.
    #[error("a good key is needed: send the metadata `authorization: Bearer KEY` once")]
    Unauthenticated,
    #[error("this key may not do that; it needs the role {0}")]
    Role(Role),
    #[error(
        "this server needs no key, so it answers requests to its own address alone, as localhost; name it so, add this host \
         with --public-host, or require keys (--require-keys)"
    )]
    Host,
    #[error("a request has one Host")]
    Hosts,
    #[error(
        "this server needs no key, so it answers no page of another site; allow the site with --cors-origin, or require keys \
         (--require-keys)"
    )]
    Origin,
    #[error("a page must send another Content-Type, as application/json, application/octet-stream or that of a mesh")]
    MediaType,
    #[error("this key is its own tenant's; leave out {TENANT}")]
    Tenant,
    #[error("{TENANT} is no name, or is there twice: take 1 to 128 printable ASCII characters without spaces, once")]
    TenantName,
    #[error("this server has no such method")]
    Unknown,
    #[error("this key has {limit} calls a second")]
    Rate { limit: u32, wait: Duration },
    #[error("this key has {limit} calls open already, as many as it may")]
    InFlight { limit: u32 },
    #[error("this key has {used_bytes} bytes of blobs, and may have {limit_bytes}; delete blobs or jobs first")]
    Bytes { used_bytes: u64, limit_bytes: u64 },
}

impl From<Foreign> for Refusal {
    fn from(foreign: Foreign) -> Self {
        match foreign {
            Foreign::Host => Self::Host,
            Foreign::Hosts => Self::Hosts,
            Foreign::Origin => Self::Origin,
            Foreign::MediaType => Self::MediaType,
        }
    }
}

/// The caller, for handlers. A call without a key has none.
#[derive(Clone, Debug)]
pub(crate) struct Caller {
    /// The tenant in whose name it calls.
    pub tenant: String,
    /// What blobs the tenant may have, bytes.
    pub bytes: Option<u64>,
}

impl Access {
    /// Access without keys. Callers name their tenants themselves.
    pub fn open() -> Self {
        Self::new(None, AccessOptions::default(), Table::default())
    }

    /// As [`Self::open`], with other options. There are no keys: a call that needs one is refused.
    #[must_use]
    pub fn with(&self, options: AccessOptions) -> Self {
        Self::new(None, options, Table::default())
    }

    /// By the keys of a server's folder, now and as they change. Errors: `Io`, `Damaged`.
    pub fn in_folder(folder: &Path, options: AccessOptions) -> Result<Self, KeysError> {
        let file = KeyFile::in_folder(folder);
        let set = file.read()?;
        Ok(Self::with_keys(Home::File(file), options, &set))
    }

    /// By the keys of a store that several servers share, now and as they change. Errors: `Shared`.
    pub async fn in_store(store: Arc<dyn JobStore>, options: AccessOptions) -> Result<Self, KeysError> {
        let home = Home::Store(store);
        let set = home.look(None).await.map_or_else(|| Ok(KeySet::default()), |(_, set)| set)?;
        Ok(Self::with_keys(home, options, &set))
    }

    fn with_keys(home: Home, options: AccessOptions, set: &KeySet) -> Self {
        let count = set.keys().len();
        match (options.require_keys, count) {
            (false, 0) => {}
            (false, _) => tracing::warn!(
                keys = count,
                "there are keys, and calls without one are taken too; refuse them with --require-keys"
            ),
            (true, 0) => tracing::warn!("no key is there yet: every call is refused; make one with `tessera keys add`"),
            (true, _) => tracing::info!(keys = count, "calls need a key"),
        }
        let table = Table::default().next(set);
        Self::new(Some(home), options, table)
    }

    fn new(home: Option<Home>, options: AccessOptions, table: Table) -> Self {
        let shared = Shared { options, home, table: RwLock::new(table), log: Seldom::default() };
        Self { shared: Arc::new(shared), reach: Reach::Anywhere }
    }

    /// The same for the requests of one listener; one that other machines reach has the hosts of `wide`.
    pub fn of(&self, listener: &TcpListener, wide: Reach) -> Self {
        Self { shared: Arc::clone(&self.shared), reach: hosts::reach(listener, wide) }
    }

    pub fn options(&self) -> &AccessOptions {
        &self.shared.options
    }

    fn table(&self) -> RwLockReadGuard<'_, Table> {
        self.shared.table.read().unwrap_or_else(PoisonError::into_inner)
    }

    /// Follows the keys in a task of `tasks`. Weights of tenants go to `weights`. Calls that are open at other servers come from
    /// `api`, and those here go there.
    pub fn follow(&self, weights: Weights, api: Option<Arc<dyn JobApi>>, tasks: &mut JoinSet<()>) {
        weights.set(self.table().weights());
        let Some(home) = self.shared.home.clone() else { return };
        let api = api.filter(|_| matches!(home, Home::Store(_)));
        let access = self.clone();
        tasks.spawn(async move {
            let mut hangups = Hangups::new();
            // Read once more: it may have changed since the start.
            let (mut seen, mut complaint) = (None, None);
            loop {
                access.look(&home, &mut seen, &mut complaint, &weights).await;
                if let Some(api) = &api {
                    access.share_calls(&**api).await;
                }
                tokio::select! {
                    () = tokio::time::sleep(LOOK_EVERY) => {}
                    () = hangups.next() => seen = None,
                }
            }
        });
    }

    /// Reads the keys if they have changed, and lets go of keys whose time is over.
    async fn look(&self, home: &Home, seen: &mut Option<Seen>, complaint: &mut Option<String>, weights: &Weights) {
        match home.look(*seen).await {
            Some((stamp, Ok(set))) => {
                *seen = stamp;
                *complaint = None;
                let mut table = self.shared.table.write().unwrap_or_else(PoisonError::into_inner);
                if table.differs(&set) {
                    *table = table.next(&set);
                    tracing::info!(keys = set.keys().len(), "the keys have changed");
                }
                weights.set(table.weights());
            }
            Some((stamp, Err(error))) => {
                // A file that cannot be read now may be read soon, with the same stamp: it is looked at again.
                let is_damaged = matches!(error, KeysError::Damaged { .. });
                *seen = stamp.filter(|_| is_damaged);
                let text = error.to_string();
                if complaint.as_ref() != Some(&text) {
                    tracing::error!(%error, "the keys cannot be read; those that were read last stay");
                    *complaint = Some(text);
                }
            }
            None => {}
        }
        self.table().end_expired(now());
    }

    /// Hears how many calls of each key are open at other servers.
    async fn share_calls(&self, api: &dyn JobApi) {
        let Some(cluster) = api.cluster() else { return };
        if !self.table().limits_calls() {
            return;
        }
        let open = self.table().open_calls();
        let elsewhere = cluster.share_calls(open).await;
        self.table().set_elsewhere(&elsewhere);
    }

    /// Checks a request of the HTTP interface that needs `role`; without one, there is no such resource.
    pub fn admit<B>(&self, request: &mut Request<B>, role: Option<Role>) -> Result<Option<Pass>, Refusal> {
        // RFC 9112, section 3.2. Calls of gRPC have an authority instead.
        let has_host = request.version() != Version::HTTP_11 || request.headers().contains_key(header::HOST);
        let entered = if has_host { self.enter(request, role.map(Needs::Role)) } else { Err(Refusal::Hosts) };
        entered.inspect_err(|refusal| self.note(*refusal, request.uri().path()))
    }

    /// Refuses requests that come from the pages of other sites, where no key is needed.
    pub fn check_host<B>(&self, request: &Request<B>) -> Result<(), Refusal> {
        let options = &self.shared.options;
        // A page has no key, so that it can use nothing where one is needed.
        if options.require_keys { Ok(()) } else { Ok(options.hosts.check(request, self.reach)?) }
    }

    /// Checks a request. Returns the right of the call if it has a key.
    fn enter<B>(&self, request: &mut Request<B>, needs: Option<Needs>) -> Result<Option<Pass>, Refusal> {
        hosts::check_once(request.headers())?;
        let presented = presented(request.headers());
        // No handler needs it.
        request.headers_mut().remove(header::AUTHORIZATION);
        let named = tenant(request.headers())?;
        let options = &self.shared.options;
        let Some(secret) = presented? else {
            let is_probe = needs == Some(Needs::Health) && !options.health_needs_key;
            // A tenant with a key cannot be named without it.
            if (options.require_keys && !is_probe) || named.is_some_and(|name| self.table().has(&name)) {
                return Err(Refusal::Unauthenticated);
            }
            self.check_host(request)?;
            return needs.map(|_| None).ok_or(Refusal::Unknown);
        };
        let pass = self.table().find(&secret, now()).ok_or(Refusal::Unauthenticated)?;
        let is_work = !matches!(needs, Some(Needs::Health));
        if is_work {
            pass.take_turn()?;
        }
        let key = pass.key();
        match needs.ok_or(Refusal::Unknown)? {
            Needs::Role(role) if role > key.role => return Err(Refusal::Role(role)),
            Needs::Role(_) | Needs::Health | Needs::Reflection => {}
        }
        let caller = match named {
            Some(name) if name != key.name && key.role != Role::Admin => return Err(Refusal::Tenant),
            Some(name) if name != key.name => Caller { tenant: name, bytes: None },
            _ => Caller { tenant: key.name.clone(), bytes: key.limits.bytes },
        };
        let pass = if is_work { pass.open()? } else { pass };
        request.extensions_mut().insert(caller);
        Ok(Some(pass))
    }

    /// Says now and then that keys are refused.
    fn note(&self, refusal: Refusal, path: &str) {
        if refusal == Refusal::Unauthenticated
            && let Some(times) = self.shared.log.count()
        {
            tracing::warn!(path, times, "refused calls without a good key");
        } else {
            tracing::debug!(path, reason = %refusal, "refused a call");
        }
    }
}

/// The key that a request comes with, if any. Two are as bad as a wrong one.
fn presented(headers: &HeaderMap) -> Result<Option<Secret>, Refusal> {
    let mut all = headers.get_all(header::AUTHORIZATION).iter();
    let (Some(value), None) = (all.next(), all.next()) else {
        return if headers.contains_key(header::AUTHORIZATION) { Err(Refusal::Unauthenticated) } else { Ok(None) };
    };
    let parsed = || {
        let (scheme, key) = value.to_str().ok()?.split_once(' ')?;
        scheme.eq_ignore_ascii_case("bearer").then(|| Secret::parse(key))?
    };
    parsed().map(Some).ok_or(Refusal::Unauthenticated)
}

/// The longest name of a tenant, bytes.
const LONGEST: usize = 128;

pub(super) fn tenant(headers: &HeaderMap) -> Result<Option<String>, Refusal> {
    let mut all = headers.get_all(TENANT).iter();
    let Some(value) = all.next() else { return Ok(None) };
    let name = value.to_str().unwrap_or_default();
    let is_good = (1..=LONGEST).contains(&name.len()) && name.bytes().all(|byte| byte.is_ascii_graphic());
    match is_good && all.next().is_none() {
        true => Ok(Some(name.to_owned())),
        false => Err(Refusal::TenantName),
    }
}

/// SIGHUP, where there is one.
struct Hangups {
    #[cfg(unix)]
    signal: Option<tokio::signal::unix::Signal>,
}

impl Hangups {
    fn new() -> Self {
        Self {
            #[cfg(unix)]
            signal: tokio::signal::unix::signal(tokio::signal::unix::SignalKind::hangup()).ok(),
        }
    }

    /// Ready at the next one.
    async fn next(&mut self) {
        #[cfg(unix)]
        if let Some(signal) = &mut self.signal
            && signal.recv().await.is_some()
        {
            return;
        }
        std::future::pending().await
    }
}

#[derive(Clone)]
pub(super) struct Guarded {
    access: Access,
    routes: Routes,
}

impl Guarded {
    pub(super) fn new(access: Access, routes: Routes) -> Self {
        Self { access, routes }
    }

    /// Has a request answered, if it may be.
    pub(super) async fn call(mut self, mut request: Request<Body>) -> Response<Body> {
        if let Some(refused) = foreign(&request) {
            return refused;
        }
        let needs = methods::needs(request.uri().path());
        let pass = match self.access.enter(&mut request, needs) {
            Ok(pass) => pass,
            Err(refusal) => {
                self.access.note(refusal, request.uri().path());
                return Status::from(RequestError::Access(refusal)).into_http();
            }
        };
        let answering = self.routes.call(request);
        let Some(pass) = pass else {
            let Ok(response) = answering.await;
            return response;
        };
        let Ok(response) = tokio::select! {
            response = answering => response,
            () = pass.ended() => return Status::from(RequestError::unauthenticated()).into_http(),
        };
        response.map(|body| Body::new(Held::new(body, pass)))
    }
}

/// The answer to what is no gRPC, in HTTP's words: its sender knows no others.
fn foreign(request: &Request<Body>) -> Option<Response<Body>> {
    let is_grpc = |kind: &str| {
        let rest = kind.strip_prefix("application/grpc")?;
        matches!(rest.chars().next(), None | Some('+' | ';')).then_some(())
    };
    let kind = request.headers().get(header::CONTENT_TYPE).and_then(|kind| kind.to_str().ok());
    let status = match (request.method(), kind.and_then(is_grpc)) {
        (&Method::POST, Some(())) => return None,
        (&Method::POST, None) => StatusCode::UNSUPPORTED_MEDIA_TYPE,
        _ => StatusCode::METHOD_NOT_ALLOWED,
    };
    let mut response = Response::new(Body::default());
    *response.status_mut() = status;
    if status == StatusCode::METHOD_NOT_ALLOWED {
        response.headers_mut().insert(header::ALLOW, HeaderValue::from_static("POST"));
    }
    Some(response)
}

#[cfg(test)]
mod tests;
