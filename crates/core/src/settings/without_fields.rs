//! Checks of methods without radiance fields: sections `srn`, `nv` and `llff`, and operations that these methods do not
//! support.

use super::validate::{refuse, require};
use super::{Capability, Config, DataKind, Representation, TermNeeds};
use crate::base::{Error, Result};

impl Config {
    /// Checks the section of a method without fields, and rejects settings that do not apply to it.
    pub(super) fn validate_representation(&self) -> Result<()> {
        let wrong = self.nv.wrong().map(|wrong| ("nv", wrong)).or(self.llff.wrong().map(|wrong| ("llff", wrong)));
        if let Some((section, (name, value, allowed))) = wrong {
            require(false, &format!("{section}.{name}"), value, &allowed)?;
        }
        // The encoding of a field may not suit the method, which is checked elsewhere.
        let Some(representation) = self.method.representation(self.field.encoding) else { return Ok(()) };
        let side = self.eval.mesh.resolution;
        if side > 0 {
            self.require_capability(Capability::Density, &format!("eval.mesh.resolution = {side}"), "set it to 0")?;
        }
        if self.method.has_fields() {
            return Ok(());
        }
        for term in &self.regularizer.kind {
            let capability = match term.needs() {
                TermNeeds::Density(_) | TermNeeds::Slopes => Capability::Derivatives,
                TermNeeds::Samples(_) => Capability::Samples,
                // Refused with the encoding.
                TermNeeds::Tables => continue,
            };
            let what = format!("regularizer.kind = \"{}\"", term.name());
            self.require_capability(capability, &what, "leave it empty, or use nerf or aug-nerf")?;
        }
        self.check_space(representation)
    }

    /// Rejects a space in which the method does not work.
    fn check_space(&self, representation: Representation) -> Result<()> {
        let (data, method) = (&self.data, self.method.name());
        let forward = data.kind.forward_facing() && !data.spherify;
        refuse(representation == Representation::Volume && forward, || {
            let around = match data.kind {
                DataKind::Llff => ", or data.spherify=true if the cameras go around an object",
                _ => "",
            };
            format!(
                "data.kind = \"{}\" with method {method}: a forward-facing scene has no bounded box and no known background, which \
                 Neural Volumes need (the paper has no such row, either); use srn, llff, nerf or aug-nerf{around}",
                data.kind.name()
            )
        })?;
        refuse(data.in_ndc(), || {
            format!(
                "data.ndc = true with method {method}: it works with distances in the world, which normalized device coordinates \
                 bend; set data.ndc=false"
            )
        })
    }

    /// Returns the error for an operation that the method does not support. `what` begins the sentence, and `instead`
    /// ends it.
    ///
    /// # Errors
    /// [`Error::Config`] if the method's representation lacks the capability.
    pub fn require_capability(&self, capability: Capability, what: &str, instead: &str) -> Result<()> {
        match self.representation().lacks(capability) {
            None => Ok(()),
            Some(why) => Err(Error::Config(format!("{what} with method {}: {why}; {instead}", self.method.name()))),
        }
    }
}
