//! Every option survives both directions.
