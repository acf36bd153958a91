//! mirador with one registration method more: same commands, same processes, same outputs.

mod damped;

use std::process::ExitCode;

fn main() -> ExitCode {
    let mut registry = mirador::Registry::default();
    registry.register("damped", |config| Box::new(damped::Damped::new(config)));
    mirador::main_with(registry)
}

#[cfg(test)]
mod conformance {
    mirador_core::registration_conformance!(|config| Box::new(crate::damped::Damped::new(config)));
}
