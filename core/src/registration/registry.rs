//! Registration methods by name.

use std::collections::BTreeMap;
use std::fmt;

use thiserror::Error;

use super::iteration::Minimiser;
use super::methods::{Generalised, Method, NormalDistributions, PointToPlane, PointToPoint, Symmetric, Voxelised};
use super::{ConfigError, Registration, RegistrationConfig};

/// Makes a method from its settings.
type Constructor = Box<dyn Fn(&RegistrationConfig) -> Box<dyn Registration> + Send + Sync>;

/// The registration methods that a configuration can name.
///
/// ```
/// use mirador_core::registration::{Registry, RegistrationConfig};
///
/// let registry = Registry::default();
/// let method = registry.create("gicp", &RegistrationConfig::default()).unwrap();
/// assert_eq!(method.name(), "gicp");
/// ```
pub struct Registry {
    constructors: BTreeMap<String, Constructor>,
}

/// Why no method could be made.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum RegistryError {
    /// No method has this name.
    #[error("there is no registration method called `{name}`; known are: {}", known.join(", "))]
    UnknownRegistration {
        /// The name asked for.
        name: String,
        /// The names there are, sorted.
        known: Vec<String>,
    },
    /// The settings are out of range.
    #[error("registration: {0}")]
    Config(#[from] ConfigError),
}

impl Registry {
    /// Without any method, not even the built-in ones.
    #[must_use]
    pub fn empty() -> Self {
        Self { constructors: BTreeMap::new() }
    }

    /// Adds a method, or replaces the one of the same name.
    pub fn register(
        &mut self,
        name: &str,
        constructor: impl Fn(&RegistrationConfig) -> Box<dyn Registration> + Send + Sync + 'static,
    ) {
        self.constructors.insert(name.to_owned(), Box::new(constructor));
    }

    /// The names, sorted.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.constructors.keys().map(String::as_str)
    }

    /// Makes the method called `name`.
    ///
    /// # Errors
    /// [`RegistryError::UnknownRegistration`] with the names there are, [`RegistryError::Config`] with the field.
    pub fn create(&self, name: &str, config: &RegistrationConfig) -> Result<Box<dyn Registration>, RegistryError> {
        config.validate()?;
        match self.constructors.get(name) {
            Some(constructor) => Ok(constructor(config)),
            None => Err(RegistryError::UnknownRegistration {
                name: name.to_owned(),
                known: self.constructors.keys().cloned().collect(),
            }),
        }
    }
}

impl Default for Registry {
    /// The built-in methods.
    fn default() -> Self {
        let mut registry = Self::empty();
        registry.add::<PointToPoint>();
        registry.add::<PointToPlane>();
        registry.add::<Symmetric>();
        registry.add::<Generalised>();
        registry.add::<Voxelised>();
        registry.add::<NormalDistributions>();
        registry
    }
}

impl Registry {
    /// Adds a built-in method under its own name.
    fn add<M: Minimiser + 'static>(&mut self)
    where
        M::Sum: Send,
        <M::Approach as Minimiser>::Sum: Send,
    {
        self.register(M::NAME, |config| Box::new(Method::<M>::new(config.clone())));
    }
}

impl fmt::Debug for Registry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_set().entries(self.constructors.keys()).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_name_is_told_which_names_there_are() {
        let error = Registry::default().create("icp", &RegistrationConfig::default()).err().unwrap();
        let text = error.to_string();
        assert!(text.contains("`icp`") && text.contains("point_to_plane, point_to_point"), "{text}");
    }

    #[test]
    fn settings_out_of_range_are_refused_before_a_method_is_made() {
        let config = RegistrationConfig { threads: 0, ..RegistrationConfig::default() };
        let error = Registry::default().create(PointToPlane::NAME, &config).err().unwrap();
        assert!(error.to_string().contains("threads"), "{error}");
    }
}
