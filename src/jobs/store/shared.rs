//! What a store has more that several processes use at the same time.
//!
//! Purpose: [`SharedStore`], and what servers say of themselves and see of each other. Invariant: only the store's clock says which
//! server is alive. Must not know: SQL, how jobs are done.

use std::collections::{BTreeMap, HashMap};
use std::time::Duration;

use serde::Serialize;
use tokio::sync::watch;

use super::Answer;
use crate::record::{Bytes, JobId};

/// A server that was not heard of for so long is away.
pub const AWAY: Duration = Duration::from_secs(15);

/// A store of jobs that several processes use at the same time. Each claims what it has room for, and queues nothing.
pub trait SharedStore: Send + Sync {
    /// The name of this process, which no other has: the holder of its leases.
    fn holder(&self) -> &str;

    /// Changes when jobs may have come to wait. A change may be missed.
    fn work(&self) -> watch::Receiver<()>;

    /// Jobs that wait, by tenant.
    fn waiting(&self) -> Answer<'_, HashMap<String, usize>>;

    /// Says that this process is alive, and what it is. Gives whether an operator wants it to take no more work.
    fn beat(&self, node: Node) -> Answer<'_, bool>;

    /// Whether this process is the one that sweeps now.
    fn sweeps(&self) -> Answer<'_, bool>;

    /// Tells how many calls are open here by key, and gives how many are at the servers that are alive beside this one.
    fn share_calls(&self, open: BTreeMap<String, u32>) -> Answer<'_, BTreeMap<String, u32>>;

    /// A text that all servers read and operators change, with its version; none if there is none.
    fn document(&self, name: &'static str) -> Answer<'_, Option<Document>>;

    /// This process is about to end.
    fn leave(&self) -> Answer<'_, ()>;

    /// All servers and all work.
    fn overview(&self) -> Answer<'_, Overview>;

    /// Why a queued job is done by no server that is alive; `None` if one can do it, or if it does not wait.
    fn unschedulable(&self, id: JobId) -> Answer<'_, Option<Unschedulable>>;
}

/// See [`SharedStore::document`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Document {
    /// Rises with every change.
    pub version: i64,
    pub content: String,
}

/// What a server does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, strum::Display, strum::EnumString, strum::FromRepr)]
#[serde(rename_all = "lowercase")]
#[strum(serialize_all = "lowercase")]
#[repr(i16)]
pub enum Role {
    /// Takes calls and does work.
    #[default]
    All,
    /// Takes calls alone.
    Gateway,
    /// Does work alone.
    Worker,
}

impl Role {
    pub fn works(self) -> bool {
        self != Self::Gateway
    }

    pub fn takes_calls(self) -> bool {
        self != Self::Worker
    }
}

/// What a server says of itself.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Node {
    /// As operators call it.
    pub name: String,
    pub role: Role,
    pub version: String,
    /// Where it takes calls; empty if it takes none.
    pub address: String,
    pub has_gpu: bool,
    /// Jobs at work at once.
    pub places: u32,
    /// Memory for jobs.
    pub memory: Bytes,
    /// Jobs of the store that it has at work.
    pub at_work: u32,
    /// What all its work is planned to need.
    pub planned: Bytes,
}

/// A server, as the others see it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Member {
    pub node: Node,
    /// Its process, as leases name it.
    pub holder: String,
    pub is_alive: bool,
    /// An operator wants it to take no more work.
    pub drains: bool,
    /// Since it was heard of last.
    pub seen_ms: u64,
    pub up_ms: u64,
}

impl Member {
    /// Whether it takes jobs.
    pub fn works(&self) -> bool {
        self.is_alive && !self.drains && self.node.role.works()
    }

    /// Whether it could do a job when nothing else is at work there.
    pub fn can_do(&self, needs: Bytes, needs_gpu: bool) -> bool {
        self.works() && needs.fits(self.node.memory) && (self.node.has_gpu || !needs_gpu)
    }
}

/// Jobs of a tenant that have not ended.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Line {
    pub tenant: String,
    pub queued: u64,
    pub running: u64,
    /// How long its oldest queued job waits.
    pub oldest_ms: u64,
}

/// A job at work.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Lease {
    #[serde(serialize_with = "as_text")]
    pub job: JobId,
    pub holder: String,
    /// Until it ends; below 0 if it is over.
    pub left_ms: i64,
}

fn as_text<S: serde::Serializer>(id: &JobId, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(id)
}

/// All servers and all work.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Overview {
    pub members: Vec<Member>,
    pub lines: Vec<Line>,
    /// At most a thousand, those that end first.
    pub leases: Vec<Lease>,
}

impl Overview {
    pub fn queued(&self) -> u64 {
        self.lines.iter().map(|line| line.queued).sum()
    }

    pub fn running(&self) -> u64 {
        self.lines.iter().map(|line| line.running).sum()
    }

    pub fn oldest_ms(&self) -> u64 {
        self.lines.iter().map(|line| line.oldest_ms).max().unwrap_or(0)
    }

    /// Servers that take jobs, and how many jobs they have at work at once.
    pub fn capacity(&self) -> (usize, u64) {
        let working = self.members.iter().filter(|member| member.works());
        working.fold((0, 0), |(nodes, places), member| (nodes + 1, places + u64::from(member.node.places)))
    }

    /// Queued and running work in servers: how many would have it at work at once.
    pub fn load(&self) -> f64 {
        let (nodes, places) = self.capacity();
        let work = (self.queued() + self.running()) as f64;
        if places == 0 { work } else { work * nodes as f64 / places as f64 }
    }
}

/// Why no server that is alive does a job.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unschedulable {
    #[error("no server that does work is alive; it waits for one")]
    NoServer,
    #[error("it needs a GPU, and no server that is alive has one; it waits for one")]
    NoGpu,
    #[error(
        "it needs {} MiB of memory and {} MiB of the device's, and no server that is alive has so much; it waits for one",
        needs.host >> 20, needs.device >> 20
    )]
    TooLarge { needs: Bytes },
}

impl Unschedulable {
    /// Why none of these does a job that needs so much.
    pub fn of(members: &[Member], needs: Bytes, needs_gpu: bool) -> Option<Self> {
        let mut working = members.iter().filter(|member| member.works()).peekable();
        let Some(_) = working.peek() else { return Some(Self::NoServer) };
        let mut able = working.filter(|member| member.node.has_gpu || !needs_gpu).peekable();
        let Some(_) = able.peek() else { return Some(Self::NoGpu) };
        let fits = able.any(|member| member.can_do(needs, needs_gpu));
        (!fits).then_some(Self::TooLarge { needs })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn member(host: u64, has_gpu: bool) -> Member {
        let node = Node { memory: Bytes { host, device: 0 }, has_gpu, places: 2, ..Node::default() };
        Member { node, holder: String::new(), is_alive: true, drains: false, seen_ms: 0, up_ms: 0 }
    }

    #[test]
    fn what_no_server_does_has_its_reason() {
        let needs = Bytes { host: 10, device: 0 };
        let drained = Member { drains: true, ..member(100, true) };
        let away = Member { is_alive: false, ..member(100, true) };
        let gateway = Member { node: Node { role: Role::Gateway, ..member(100, true).node }, ..member(0, true) };
        let idle = [drained, away, gateway];
        assert_eq!(Unschedulable::of(&idle, needs, false), Some(Unschedulable::NoServer));
        let with = |member: Member| [&idle[..], &[member]].concat();
        assert_eq!(Unschedulable::of(&with(member(10, false)), needs, false), None);
        assert_eq!(Unschedulable::of(&with(member(10, false)), needs, true), Some(Unschedulable::NoGpu));
        assert_eq!(Unschedulable::of(&with(member(9, true)), needs, true), Some(Unschedulable::TooLarge { needs }));
    }

    #[test]
    fn load_is_counted_in_servers() {
        let line = |queued, running| Line { queued, running, ..Line::default() };
        let members = vec![member(1, false), member(1, false)];
        let overview = Overview { members, lines: vec![line(5, 1), line(0, 2)], leases: Vec::new() };
        assert_eq!((overview.capacity(), overview.load()), ((2, 4), 4.0));
        // What waits is seen also if no server is alive.
        assert_eq!(Overview { members: Vec::new(), ..overview }.load(), 8.0);
    }
}
