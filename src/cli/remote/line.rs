//! A connection for a caller that makes many calls on it at once, for several tenants.
//!
//! Invariant: the server answered on it once before it is handed out. Must not know: what is asked.

use anyhow::Result;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Channel;

use super::link::{Caller, Door, Link, Patience, Windows};
use crate::server::{Server, Tenant};

/// See the module's head.
#[derive(Clone, Debug)]
pub(crate) struct Line {
    server: Server,
    channel: Channel,
}

impl Line {
    /// Connects.
    ///
    /// # Errors
    /// The server cannot be reached, or does not answer.
    pub(crate) async fn open(server: &Server, windows: Windows) -> Result<Self> {
        let link = Link::open_with(server, Patience::with(0), windows).await?;
        Ok(Self { server: server.clone(), channel: link.into_channel() })
    }

    /// What calls of a tenant are made on; of the server's own tenant if none is named.
    ///
    /// # Errors
    /// The tenant or the key cannot be sent.
    pub(crate) fn door(&self, tenant: Option<&Tenant>) -> Result<Door> {
        let server = Server { tenant: tenant.or(self.server.tenant.as_ref()).cloned(), ..self.server.clone() };
        Ok(InterceptedService::new(self.channel.clone(), Caller::of(&server)?))
    }
}
