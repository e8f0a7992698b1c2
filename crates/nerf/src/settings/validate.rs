//! Checks of sections against one another. Each section checks its own settings.

use super::{
    Capability, ChangedEntries, Config, Core, CorruptionKind, DataKind, Encoding, MESH_SIDES, Objective, PerturbField,
    Placing, Regularizer, Representation, Resample, SecondPass, Spacing, TermNeeds, UnseenPoses, word,
};
use crate::base::settings::{refuse, require};
use crate::base::{Error, Result};
use crate::perturb::{Geometry, Passes};

/// Returns an error with the first sentence whose condition holds.
fn refuse_first<const N: usize>(refusals: [(bool, String); N]) -> Result<()> {
    refusals.into_iter().try_for_each(|(wrong, message)| refuse(wrong, message))
}

impl Config {
    /// Checks every setting, and the settings against one another.
    ///
    /// # Errors
    /// [`Error::Setting`] for the first setting out of its range, [`Error::Config`] for settings that contradict each
    /// other.
    pub fn validate(&self) -> Result<()> {
        self.check_ranges()?;
        self.data.validate()?;
        self.nv.validate()?;
        self.llff.validate()?;
        let side = self.eval.mesh.resolution;
        let allowed = format!("0 (no surface), or {} to {} cells a side", MESH_SIDES.start(), MESH_SIDES.end());
        require(side == 0 || MESH_SIDES.contains(&side), "eval.mesh.resolution", side, &allowed)?;
        if self.method.has_fields() {
            self.field.validate()?;
            self.validate_representation()?;
            self.validate_sampling()?;
            self.validate_second_pass()?;
        } else {
            self.validate_without_fields()?;
        }
        self.validate_capabilities()?;
        self.perturb.validate()?;
        self.regularizer.validate()?;
        self.validate_terms()
    }

    fn validate_representation(&self) -> Result<()> {
        let message = format!(
            "field.encoding = \"{}\" is not that of method {}: integrated is for mip-nerf and aug-mip-nerf, positional and hash \
             are for nerf and aug-nerf; choose another method, encoding or preset",
            word(self.field.encoding),
            self.method.name()
        );
        refuse(self.method.representation(self.field.encoding).is_none(), message)
    }

    /// Rejects terms and surfaces for which the representation has no answer.
    fn validate_capabilities(&self) -> Result<()> {
        for term in &self.regularizer.kind {
            let capability = match term.needs() {
                TermNeeds::Density(_) | TermNeeds::Slopes => Capability::Derivatives,
                TermNeeds::Samples(_) => Capability::Samples,
                // Refused with the encoding.
                TermNeeds::Tables => continue,
            };
            let what = format!("regularizer.kind = \"{}\"", term.name());
            self.require_capability(capability, &what, "leave it out, or use nerf or aug-nerf")?;
        }
        let side = self.eval.mesh.resolution;
        let what = format!("eval.mesh.resolution = {side}");
        if side > 0 { self.require_capability(Capability::Density, &what, "set it to 0") } else { Ok(()) }
    }

    /// Rejects scenes for which a method without fields has no answer.
    fn validate_without_fields(&self) -> Result<()> {
        let (data, method, kind) = (&self.data, self.method.name(), self.data.kind.name());
        let forward = data.kind.forward_facing() && !data.spherify;
        let around = match data.kind {
            DataKind::Llff => ", or data.spherify=true if the cameras go around an object",
            _ => "",
        };
        refuse_first([
            (
                forward && self.representation() == Representation::Volume,
                format!(
                    "data.kind = \"{kind}\" with method {method}: a forward-facing scene has no bounded box and no known \
                     background, which Neural Volumes need (the paper has no such row, either); use srn, llff, nerf or \
                     aug-nerf{around}"
                ),
            ),
            (
                data.in_ndc(),
                format!(
                    "data.ndc = true with method {method}: it works with distances in the world, which normalized device \
                     coordinates bend; set data.ndc=false"
                ),
            ),
            (
                self.train.gradient_scaling,
                format!(
                    "train.gradient_scaling = true with method {method}: it has no samples along rays; set it to false"
                ),
            ),
        ])
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

    fn validate_sampling(&self) -> Result<()> {
        let in_disparity = self.sampling.spacing == Spacing::Disparity;
        let of_paper = self.method.is_augmented() && self.perturb.geometry == Geometry::Paper;
        refuse_first([
            (
                in_disparity && self.data.in_ndc(),
                "sampling.spacing = \"disparity\" with data.ndc: normalized device coordinates are even in disparity already; \
                 set data.ndc=false, or leave sampling.spacing at \"depth\""
                    .into(),
            ),
            (
                in_disparity && of_paper,
                "sampling.spacing = \"disparity\" with perturb.geometry = \"paper\": the paper's gaps are those of samples that \
                 are even in depth; leave perturb.geometry at \"sampling\""
                    .into(),
            ),
        ])?;
        if self.sampling.kind == Placing::Occupancy {
            self.validate_occupancy()?;
        }
        let openings = [
            ("field.frequency_steps", self.field.frequency_steps, "or the encodings never open"),
            ("sampling.anneal_steps", self.sampling.anneal_steps, "or training never sees whole rays"),
        ];
        for (name, steps, why) in openings {
            let allowed = format!("at most train.steps ({}), {why}", self.train.steps);
            require(steps <= self.train.steps, name, steps, &allowed)?;
        }
        let fine = self.sampling.fine;
        let (is_possible, allowed) = match self.field.encoding {
            Encoding::Positional => return Ok(()),
            Encoding::Integrated => (fine != 1, "0 (coarse only) or at least 2 intervals"),
            Encoding::Hash => (
                fine >= 2,
                "at least 2 with field.encoding = \"hash\", whose coarse pass only places the samples of the fine one",
            ),
        };
        require(is_possible, "sampling.fine", fine, allowed)
    }

    /// Refuses what cells of a hash grid cannot place samples with.
    fn validate_occupancy(&self) -> Result<()> {
        let of_samples = [Regularizer::Cauchy, Regularizer::InformationGain];
        let other_samples =
            of_samples.iter().find(|term| self.regularizer.kind.contains(term)).map_or("", |term| term.name());
        let of_kind = "sampling.kind = \"occupancy\"";
        refuse_first([
            (
                !self.on_hash_grid(),
                format!(
                    "{of_kind} needs a hash grid, whose cube its cells divide; set field.encoding = \"hash\", or \
                     sampling.kind=resampled"
                ),
            ),
            (
                self.sampling.density_noise.is_some_and(|noise| noise > 0.0),
                format!(
                    "{of_kind} with sampling.density_noise above 0: noise is density where space is empty; set \
                     sampling.density_noise=0"
                ),
            ),
            (
                self.sampling.spacing == Spacing::Disparity,
                format!(
                    "{of_kind} with sampling.spacing = \"disparity\": a cell is empty by the depth of intervals of one length; set \
                     sampling.spacing=depth"
                ),
            ),
            (
                !other_samples.is_empty(),
                format!(
                    "{of_kind} with regularizer.kind = \"{other_samples}\": that term needs all samples of a ray; \
                     set sampling.kind=resampled"
                ),
            ),
        ])
    }

    fn validate_second_pass(&self) -> Result<()> {
        let (perturb, chunk, rays) = (&self.perturb, self.train.chunk, self.train.rays);
        let lambda = perturb.lambda.max(perturb.lambda_schedule.at(perturb.lambda, 0));
        let allowed = "0 or positive, and at most 1 with perturb.objective = \"released\"";
        require(perturb.objective == Objective::Paper || lambda <= 1.0, "perturb.lambda", lambda, allowed)?;
        let fresh = !perturb.second.perturbs();
        refuse(
            fresh && perturb.field == PerturbField::Separate,
            "perturb.kind = \"fresh-jitter\" is a second pass of the same fields; perturb.field must be \"shared\"",
        )?;
        if !self.method.is_augmented() {
            return Ok(());
        }
        let on_grid = self.field.encoding == Encoding::Hash;
        let separable = on_grid && self.field.core == Core::Fused && perturb.field == PerturbField::Shared;
        let permutes = perturb.second == SecondPass::Permuted;
        let alone = self.sampling.first_rays(rays).chain([rays]).find(|rays| rays % chunk == 1);
        let still = !self.sampling.jitter && self.sampling.density_noise == Some(0.0);
        refuse_first([
            (
                perturb.entries == ChangedEntries::Clean && !separable,
                "perturb.entries = \"clean\" needs the entries of a hash grid that both passes share; use field.encoding = \
                 \"hash\", field.core = \"fused\" and perturb.field = \"shared\""
                    .into(),
            ),
            (
                permutes && (chunk == 1 || alone.is_some()),
                format!(
                    "perturb.kind = \"permuted\" with train.chunk = {chunk} and {} rays in a step: a chunk has one ray, whose \
                     deltas no other ray can take; choose a train.chunk that leaves no chunk of one ray",
                    alone.unwrap_or(rays)
                ),
            ),
            (
                on_grid && perturb.resample == Resample::Perturbed,
                "perturb.resample = \"perturbed\" with field.encoding = \"hash\": there is no perturbed coarse pass to \
                 resample from; use \"clean\""
                    .into(),
            ),
            (
                fresh && still,
                "perturb.kind = \"fresh-jitter\" needs sampling.jitter = true or sampling.density_noise above 0: otherwise the \
                 second pass equals the first"
                    .into(),
            ),
            (
                !fresh && perturb.sites_on().next().is_none(),
                "a perturbed method with every perturb.*.passes = \"off\" perturbs nothing; use method = \"nerf\" or \
                 \"mip-nerf\", or perturb.kind = \"fresh-jitter\" for the control"
                    .into(),
            ),
        ])?;
        // A site whose passes the method does not have would never be perturbed, and the training would not say so.
        let missing = [
            (
                on_grid,
                Passes::Coarse,
                "field.encoding = \"hash\": the coarse pass of a hash field only places samples",
                "\"fine\"",
            ),
            (self.sampling.fine == 0, Passes::Fine, "sampling.fine = 0: there is no fine pass", "\"coarse\""),
        ];
        for (is_missing, passes, why, other) in missing {
            let alone = perturb.sites_on().find(|(_, site)| is_missing && !fresh && site.passes == passes);
            let name = alone.map_or("", |(site, _)| site.name());
            let found = word(passes);
            let refusal = format!(
                "perturb.{name}.passes = \"{found}\" with {why}, so this site is never perturbed; use {other}, \"both\" (the same \
                 here) or \"off\""
            );
            refuse(alone.is_some(), refusal)?;
        }
        let (layer, depth) = (perturb.injection_layer, self.field.depth);
        let is_there = fresh || !perturb.feature.on() || (1..=depth).contains(&layer);
        require(is_there, "perturb.injection_layer", layer, &format!("1 to {depth} (field.depth)"))
    }

    /// Rejects terms and scaled gradients in scenes and fields where they mean nothing.
    fn validate_terms(&self) -> Result<()> {
        let has = |term| self.regularizer.kind.contains(&term);
        let (in_ndc, scales) = (self.data.in_ndc(), self.train.gradient_scaling);
        let has_tables = self.method.has_fields() && self.field.encoding == Encoding::Hash;
        refuse_first([
            (
                scales && has(Regularizer::Orientation),
                "train.gradient_scaling = true with regularizer.kind = \"orientation\": gradients of normals are not scaled; \
                 choose one of them"
                    .into(),
            ),
            (
                scales && in_ndc,
                "train.gradient_scaling = true with data.ndc = true: t is no distance in normalized device coordinates; set \
                 data.ndc=false, or train.gradient_scaling=false"
                    .into(),
            ),
            (
                in_ndc && self.regularizer.unseen_poses == Some(UnseenPoses::Sphere),
                "regularizer.unseen_poses = \"sphere\" with data.ndc = true: cameras on all sides see nothing of a \
                 forward-facing scene; choose box or between"
                    .into(),
            ),
            (
                in_ndc && has(Regularizer::SparseDepth),
                "regularizer.kind = \"sparse-depth\" with data.ndc = true: t is no depth in normalized device coordinates; set \
                 data.ndc=false"
                    .into(),
            ),
            (
                has(Regularizer::SparseDepth) && self.data.corruption.kind == CorruptionKind::Poses,
                "regularizer.kind = \"sparse-depth\" with data.corruption.kind = \"poses\": COLMAP's points are those of the \
                 cameras before they were moved; choose one of them"
                    .into(),
            ),
            (
                has(Regularizer::Laplacian) && !self.field.has_laplacian(),
                "regularizer.kind = \"laplacian\" with field.hash.interpolation = \"linear\": a trilinear grid has no second \
                 derivative along an axis; set field.hash.interpolation = \"smoothstep\""
                    .into(),
            ),
            (
                has(Regularizer::HashDecay) && !has_tables,
                "regularizer.kind = \"hash-decay\" needs the tables of a hash grid; use nerf or aug-nerf with field.encoding = \
                 \"hash\""
                    .into(),
            ),
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::super::{build, parse_assignment};

    /// What settings of a hash field are told; nothing where they are taken.
    fn told(further: &[&str]) -> String {
        let texts = ["field.encoding=hash"].iter().chain(further);
        let set: Vec<_> = texts.map(|text| parse_assignment(text).unwrap()).collect();
        build(None, None, &set).map_or_else(|refusal| refusal.to_string(), |_| String::new())
    }

    /// A camera that is moved sees COLMAP's points elsewhere than its photo does.
    #[test]
    fn depth_at_points_needs_the_cameras_that_found_them() {
        let term = ["data.kind=colmap", "regularizer.kind=sparse-depth"];
        let told = |further: &[&str]| told(&[&term[..], further].concat());
        let message = told(&["data.corruption.kind=poses"]);
        assert!(message.contains("sparse-depth") && message.contains("data.corruption.kind = \"poses\""), "{message}");
        assert_eq!(told(&[]) + &told(&["data.corruption.kind=pepper"]), "");
    }

    /// The coarse pass of a hash field is never perturbed, and a training without a fine pass has none to perturb: such an
    /// attack would never run.
    #[test]
    fn an_attack_on_a_pass_that_is_not_there_is_refused() {
        let coarse_only = ["field.encoding=positional", "method=aug-nerf", "sampling.fine=0"];
        for passes in ["fine", "coarse", "both"] {
            let message = told(&[&coarse_only[..], &[&format!("perturb.rgb.passes={passes}")]].concat());
            let is_refused = message.contains("perturb.rgb.passes = \"fine\" with sampling.fine = 0");
            assert_eq!(is_refused, passes == "fine", "{passes}: {message}");
            assert_eq!(message.is_empty(), passes != "fine", "{passes}: {message}");
        }
        for site in ["t", "density"] {
            let message = told(&["method=aug-nerf", &format!("perturb.{site}.passes=coarse")]);
            assert!(message.contains(&format!("perturb.{site}.passes")) && message.contains("\"fine\""), "{message}");
        }
        for taken in [
            &["method=aug-nerf", "perturb.t.passes=fine"][..],
            &["method=nerf", "perturb.t.passes=coarse"],
            &["method=aug-nerf", "perturb.kind=fresh-jitter", "perturb.t.passes=coarse"],
        ] {
            assert_eq!(told(taken), "", "{taken:?}");
        }
    }

    #[test]
    fn a_hash_field_without_a_fine_pass_is_told_one_thing() {
        for fine in [0, 1] {
            let message = told(&[&format!("sampling.fine={fine}")]);
            let says = ["sampling.fine", "at least 2", "hash"].iter().all(|words| message.contains(words));
            assert!(says && !message.contains("coarse only"), "{message}");
        }
        assert_eq!(told(&["sampling.fine=2"]), "");
    }

    #[test]
    fn a_hash_grid_s_box_is_one_that_can_be_computed_with() {
        let with = |low: &str, high: &str| told(&[&format!("field.hash.bounds=[[{low},0,0],[{high},1,1]]")]);
        for (low, high) in [("-1e308", "1e308"), ("-1e-320", "1e-320"), ("0", "1e-7"), ("0", "1e13"), ("1", "0")] {
            let message = with(low, high);
            assert!(
                message.contains("field.hash.bounds") && message.contains("two corners"),
                "{low} {high}: {message}"
            );
        }
        assert_eq!(with("-1e12", "1e12") + &with("0", "1e-6"), "");
        let message = told(&["field.hash.finest=8"]);
        assert!(message.contains("field.hash.finest = 8") && message.contains("16 (field.hash.coarsest)"), "{message}");
    }
}
