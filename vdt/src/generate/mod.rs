//! Test meshes of any size.
