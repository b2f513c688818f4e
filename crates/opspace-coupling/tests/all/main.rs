//! Energies of couplings over channels.

mod coupling;
