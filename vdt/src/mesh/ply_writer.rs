//! Writes PLY files.
