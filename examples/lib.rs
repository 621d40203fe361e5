//! Small programs on the vdt libraries: see the files beside this one.
