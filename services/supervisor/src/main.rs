//! The `mirador` executable. Everything is in the library, so that a program of your own can be the same executable
//! with one registration more (see `docs/registration.md`).

fn main() -> std::process::ExitCode {
    mirador::main_with(mirador::Registry::default())
}
