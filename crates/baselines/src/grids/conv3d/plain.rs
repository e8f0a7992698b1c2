//! The convolution in candle's operations, on any device.

use candle_core::{Device, Result, Tensor};

use crate::base::tensors::leaky_relu;

use super::plan::{Group, Plan, count, cube};

/// Gathers rows by their index, multiplies and orders them.
pub(super) fn product(plan: &Plan, slope: f64, x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
    let (depth, height, width, channels) = x.dims4()?;
    let outputs = bias.dim(0)?;
    let nothing = Tensor::zeros((1, channels), x.dtype(), x.device())?;
    let cells = Tensor::cat(&[&x.reshape((depth * height * width, channels))?, &nothing], 0)?;
    let mut groups = Vec::new();
    for group in &plan.groups {
        let (rows, taps) = (count(group.cells), group.taps.len());
        let read = cells.index_select(&read_by(plan, group, x.device())?, 0)?.reshape((rows, taps * channels))?;
        let weight = weight.narrow(0, group.taps[0].weight, taps)?.reshape((taps * channels, outputs))?;
        groups.push(read.matmul(&weight)?);
    }
    let rows = Tensor::cat(&groups, 0)?.index_select(&order(plan, x.device())?, 0)?.broadcast_add(bias)?;
    let rows = if slope == 1.0 { rows } else { leaky_relu(&rows, slope)? };
    let [z, y, x] = plan.sides;
    rows.reshape((z, y, x, outputs))
}

/// Returns the cells that a group's rows read, tap by tap. A missing cell is the one after the last.
fn read_by(plan: &Plan, group: &Group, device: &Device) -> Result<Tensor> {
    let sides = plan.sources[0];
    let mut cells = Vec::with_capacity(count(group.cells) * group.taps.len());
    for row in (0..count(group.cells)).map(|row| group.place(row)) {
        for tap in &group.taps {
            let at = [0, 1, 2].map(|axis| (plan.stride * row[axis]) as isize + tap.offset[axis]);
            let inside = (0..3).all(|axis| (0..sides[axis] as isize).contains(&at[axis]));
            let flat = (at[0] * sides[1] as isize + at[1]) * sides[2] as isize + at[2];
            cells.push(if inside { flat as u32 } else { count(sides) as u32 });
        }
    }
    let number = cells.len();
    Tensor::from_vec(cells, number, device)
}

/// Returns, for each of the result's cells, its row among those of all groups.
fn order(plan: &Plan, device: &Device) -> Result<Tensor> {
    let ([_, height, width], spread) = (plan.sides, plan.spread);
    let mut rows = vec![0u32; count(plan.sides)];
    for ((group, first), block) in plan.groups.iter().zip(cube(spread)).zip(plan.rows()) {
        for row in 0..count(group.cells) {
            let place = group.place(row);
            let [z, y, x] = [0, 1, 2].map(|axis| spread * place[axis] + first[axis]);
            rows[(z * height + y) * width + x] = (block.start + row) as u32;
        }
    }
    let number = rows.len();
    Tensor::from_vec(rows, number, device)
}
