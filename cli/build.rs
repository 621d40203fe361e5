//! Links the program at a fixed address. At any address, 40,000 pointers would have to be set when it starts, of which most belong
//! to the window: the pages that they lie in, and the list of them, are 1.7 MiB of RAM in every command. (Heap, stack and libraries
//! lie at random addresses all the same.)

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    let target = ["CARGO_CFG_TARGET_OS", "CARGO_CFG_TARGET_ENV"].map(|name| std::env::var(name).unwrap_or_default());
    if target == ["linux", "gnu"] {
        println!("cargo:rustc-link-arg-bins=-no-pie");
    }
}
