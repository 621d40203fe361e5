//! Small programs on the vdt libraries.
