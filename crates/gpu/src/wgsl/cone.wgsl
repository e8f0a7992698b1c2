// Moments of the part of a ray's cone between two places, or of its cylinder (CYLINDERS): mean and variance of t, and variance across the
// axis (Barron et al. 2021, equation 7).
struct Moments { t: f32, along: f32, across: f32 }

fn moments_of(start: f32, end: f32, radius: f32) -> Moments {
    let middle = 0.5 * (start + end);
    let half = 0.5 * (end - start);
    let h = half * half;
    //#if CYLINDERS
    return Moments(middle, h / 3.0, 0.25 * radius * radius);
    //#else
    let m = middle * middle;
    let sum = 3.0 * m + h;
    let along = h / 3.0 - (4.0 / 15.0) * h * h * (12.0 * m - h) / (sum * sum);
    let across = 0.25 * m + (5.0 / 12.0) * h - (4.0 / 15.0) * h * h / sum;
    return Moments(middle + 2.0 * middle * h / sum, along, across * radius * radius);
    //#end
}

// The gradients in both places from those in the moments.
fn moments_back(start: f32, end: f32, radius: f32, d: Moments) -> vec2<f32> {
    let middle = 0.5 * (start + end);
    let half = 0.5 * (end - start);
    let h = half * half;
    //#if CYLINDERS
    let d_middle = d.t;
    let d_half = (2.0 / 3.0) * half * d.along;
    //#else
    let m = middle * middle;
    let sum = 3.0 * m + h;
    let sum2 = sum * sum;
    let far = 12.0 * m - h;
    let d_across = radius * radius * d.across;
    let d_middle = (1.0 + 2.0 * h / sum - 12.0 * m * h / sum2) * d.t
        - (48.0 / 15.0) * h * h * middle * (2.0 * sum - far) / (sum2 * sum) * d.along
        + middle * (0.5 + (24.0 / 15.0) * h * h / sum2) * d_across;
    let d_half = 12.0 * middle * m * half / sum2 * d.t
        + half * (2.0 / 3.0 - (4.0 / 15.0) * h * (4.0 * far - 2.0 * h - 4.0 * h * far / sum) / sum2) * d.along
        + half * (5.0 / 6.0 - (4.0 / 15.0) * h * (4.0 * sum - 2.0 * h) / sum2) * d_across;
    //#end
    return vec2<f32>(0.5 * (d_middle - d_half), 0.5 * (d_middle + d_half));
}
