//! Checks of what is trained without radiance fields: sections `srn`, `nv` and `llff`, and what these methods cannot be asked
//! for.

use super::validate::{refuse, require};
use super::{Capability, Config, DataKind, Representation};
use crate::base::{Error, Result};

impl Config {
    /// Checks the section of a method without fields, and refuses what does not apply to it.
    pub(super) fn validate_representation(&self) -> Result<()> {
        let wrong = self.nv.wrong().map(|wrong| ("nv", wrong)).or(self.llff.wrong().map(|wrong| ("llff", wrong)));
        if let Some((section, (name, value, allowed))) = wrong {
            require(false, &format!("{section}.{name}"), value, &allowed)?;
        }
        // Fields have an encoding that may not be theirs, which is checked elsewhere.
        let Some(representation) = self.method.representation(self.field.encoding) else { return Ok(()) };
        let side = self.eval.mesh.resolution;
        if side > 0 {
            self.require_capability(Capability::Density, &format!("eval.mesh.resolution = {side}"), "set it to 0")?;
        }
        if self.method.has_fields() {
            return Ok(());
        }
        for term in &self.regularizer.kind {
            let capability = if term.in_space() { Capability::Derivatives } else { Capability::Samples };
            let what = format!("regularizer.kind = \"{}\"", term.name());
            self.require_capability(capability, &what, "leave it empty, or use nerf or aug-nerf")?;
        }
        self.check_space(representation)
    }

    /// Refuses a space that the method does not work in.
    fn check_space(&self, representation: Representation) -> Result<()> {
        let (data, method) = (&self.data, self.method.name());
        let forward = data.kind.forward_facing() && !data.spherify;
        refuse(representation == Representation::Volume && forward, || {
            let around = match data.kind {
                DataKind::Llff => ", or data.spherify=true where the cameras go around something",
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
                "data.ndc = true with method {method}: it works with distances in the world, which normalised device coordinates \
                 bend; set data.ndc=false"
            )
        })
    }

    /// Refuses a question that the method's representation has no answer to: `what` begins the sentence, `instead` ends it.
    ///
    /// # Errors
    /// [`Error::Config`], where it lacks the capability.
    pub fn require_capability(&self, capability: Capability, what: &str, instead: &str) -> Result<()> {
        match self.representation().lacks(capability) {
            None => Ok(()),
            Some(why) => Err(Error::Config(format!("{what} with method {}: {why}; {instead}", self.method.name()))),
        }
    }
}
