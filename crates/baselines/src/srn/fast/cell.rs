//! The recurrent cell number by number, forward and backward.

use crate::srn::network::HIDDEN;

use super::weights::GATES;

/// What a step of the cell keeps for each ray: the gates (input, forget, candidate, output) after their activations,
/// the memory, and its hyperbolic tangent.
#[derive(Default)]
pub(super) struct State {
    /// `[rays, GATES]`.
    pub(super) gates: Vec<f32>,
    /// `[rays, HIDDEN]`.
    pub(super) memory: Vec<f32>,
    /// `[rays, HIDDEN]`.
    pub(super) tanh: Vec<f32>,
}

fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// Returns the state after `sums [rays, GATES]` of the gates and the memory before.
pub(super) fn forward(sums: Vec<f32>, before: &[f32]) -> State {
    let rays = sums.len() / GATES;
    let mut state = State { gates: sums, memory: vec![0.0; rays * HIDDEN], tanh: vec![0.0; rays * HIDDEN] };
    let memories = state.memory.chunks_exact_mut(HIDDEN).zip(before.chunks_exact(HIDDEN));
    let rays = state.gates.chunks_exact_mut(GATES).zip(memories).zip(state.tanh.chunks_exact_mut(HIDDEN));
    for ((gates, (memory, before)), tanh) in rays {
        let (sigmoids, rest) = gates.split_at_mut(2 * HIDDEN);
        let (candidate, output) = rest.split_at_mut(HIDDEN);
        sigmoids.iter_mut().chain(output).for_each(|gate| *gate = sigmoid(*gate));
        candidate.iter_mut().for_each(|gate| *gate = gate.tanh());
        for j in 0..HIDDEN {
            memory[j] = sigmoids[HIDDEN + j] * before[j] + sigmoids[j] * candidate[j];
            tanh[j] = memory[j].tanh();
        }
    }
    state
}

impl State {
    /// Iterates over the cell's output of a ray, `[HIDDEN]`.
    pub(super) fn output(&self, ray: usize) -> impl Iterator<Item = f32> {
        let gates = &self.gates[ray * GATES + 3 * HIDDEN..][..HIDDEN];
        gates.iter().zip(&self.tanh[ray * HIDDEN..]).map(|(gate, tanh)| gate * tanh)
    }

    /// Propagates the gradients of the output and of the memory to those of the gates' sums, `d_sums [rays, GATES]`,
    /// and of the memory before, which replaces `d_memory`.
    pub(super) fn backward(&self, before: &[f32], d_output: &[f32], d_memory: &mut [f32], d_sums: &mut [f32]) {
        for (ray, d_sums) in d_sums.chunks_exact_mut(GATES).enumerate() {
            let gates = &self.gates[ray * GATES..][..GATES];
            for j in 0..HIDDEN {
                let at = ray * HIDDEN + j;
                let [input, forget, candidate, output] = [0, 1, 2, 3].map(|gate| gates[gate * HIDDEN + j]);
                let tanh = self.tanh[at];
                let d = d_memory[at] + d_output[at] * output * (1.0 - tanh * tanh);
                d_sums[j] = d * candidate * input * (1.0 - input);
                d_sums[HIDDEN + j] = d * before[at] * forget * (1.0 - forget);
                d_sums[2 * HIDDEN + j] = d * input * (1.0 - candidate * candidate);
                d_sums[3 * HIDDEN + j] = d_output[at] * tanh * output * (1.0 - output);
                d_memory[at] = d * forget;
            }
        }
    }
}
