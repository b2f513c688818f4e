//! Recording runs to MCAP and replaying them.
