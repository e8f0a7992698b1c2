struct Trunk {
    m: u32, layers: u32,        // rows, layers
    channels: u32,              // of the encoding
    skips: u32,                 // a bit for each layer that reads the encoding beside the layer below
    injection: u32,             // the layer with a delta, from 1, or 0
    lowest: u32,                // the lowest layer, from 1, whose input's gradient is wanted
    of_layer: u32,              // fours that layers leave, each
    kept: u32,                  // a bit for each layer whose gradient is kept
    end: u32,                   // weights of all layers
}
@group(0) @binding(0) var<uniform> p: Trunk;
@group(0) @binding(3) var<storage, read> right: array<Half>;            // the weights
