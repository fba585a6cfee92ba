//! Ctrl-C and SIGTERM, and SIGHUP where it has a meaning.
//!
//! The first signal asks for a clean end, the second ends the process at once.

use geometry::token::Token;

/// What a process says that a signal ended.
pub(crate) const CODE: u8 = 130;
/// The same, of a second signal.
const AT_ONCE: i32 = CODE as i32;

/// Ready at the first signal. The second ends the process, even if this was dropped.
///
/// # Errors
/// The operating system refused.
pub(crate) fn signals() -> std::io::Result<tokio::sync::oneshot::Receiver<()>> {
    let (sender, receiver) = tokio::sync::oneshot::channel();
    let mut both = Both::new()?;
    tokio::spawn(async move {
        both.next().await;
        let _ = sender.send(());
        both.next().await;
        std::process::exit(AT_ONCE);
    });
    Ok(receiver)
}

/// Sets `token` at the first signal, for work that is not async.
///
/// # Errors
/// The operating system refused.
pub(crate) fn cancel_on_signal(token: &Token) -> std::io::Result<()> {
    let token = token.clone();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let mut both = {
        let _inside = runtime.enter();
        Both::new()?
    };
    std::thread::Builder::new().name("signals".to_owned()).spawn(move || {
        runtime.block_on(async {
            both.next().await;
            token.cancel();
            both.next().await;
            std::process::exit(AT_ONCE);
        });
    })?;
    Ok(())
}

/// Calls `work` at each SIGHUP, which ends the process no more.
///
/// # Errors
/// The operating system refused.
#[cfg(unix)]
pub(crate) fn on_hangup(work: impl Fn() + Send + 'static) -> std::io::Result<()> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut hangup = signal(SignalKind::hangup())?;
    tokio::spawn(async move {
        while hangup.recv().await.is_some() {
            work();
        }
    });
    Ok(())
}

/// There is no such signal here.
///
/// # Errors
/// None.
#[cfg(not(unix))]
pub(crate) fn on_hangup(_: impl Fn() + Send + 'static) -> std::io::Result<()> {
    Ok(())
}

#[cfg(unix)]
struct Both {
    interrupt: tokio::signal::unix::Signal,
    terminate: tokio::signal::unix::Signal,
}

#[cfg(unix)]
impl Both {
    fn new() -> std::io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self { interrupt: signal(SignalKind::interrupt())?, terminate: signal(SignalKind::terminate())? })
    }

    async fn next(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
        }
    }
}

#[cfg(not(unix))]
struct Both;

#[cfg(not(unix))]
impl Both {
    fn new() -> std::io::Result<Self> {
        Ok(Self)
    }

    async fn next(&mut self) {
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
    }
}
