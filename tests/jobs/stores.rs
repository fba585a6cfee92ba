//! The stores that every suite runs on: one line a store.

use jobs::store::*;

/// A store without jobs, and what has to outlive it.
pub type Opened = (Box<dyn JobStore>, Box<dyn std::any::Any>);

pub fn memory() -> Opened {
    (Box::new(MemoryStore::default()), Box::new(()))
}

pub fn journal() -> Opened {
    let folder = tempfile::tempdir().unwrap();
    (Box::new(RedbStore::open(folder.path(), RedbOptions::default()).unwrap()), Box::new(folder))
}

#[cfg(all(unix, feature = "postgres"))]
pub fn postgres() -> Opened {
    (Box::new(super::postgres::open(&super::postgres_server::database())), Box::new(()))
}

/// Makes a test of each suite for each store: it is given a store without jobs.
macro_rules! on_every_store {
    ($($test:ident),*) => {
        mod memory {
            $(#[test] fn $test() { let (store, _kept) = $crate::stores::memory(); $crate::wait(super::$test(&*store)); })*
        }
        mod journal {
            $(#[test] fn $test() { let (store, _kept) = $crate::stores::journal(); $crate::wait(super::$test(&*store)); })*
        }
        #[cfg(all(unix, feature = "postgres"))]
        mod postgres {
            $(#[needs::needs(postgres)]
            #[test] fn $test() { let (store, _kept) = $crate::stores::postgres(); $crate::wait(super::$test(&*store)); })*
        }
    };
}
pub(crate) use on_every_store;
