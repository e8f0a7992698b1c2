// A group a ray: each of its 32 threads has a run of samples, one behind the other.
var<workgroup> of_threads: array<vec4<f32>, 32>;
struct Sums { before: vec4<f32>, behind: vec4<f32> }
// The sums of the threads before this one and behind it. All threads call it.
fn around(thread: u32, own: vec4<f32>) -> Sums {
    workgroupBarrier();
    of_threads[thread] = own;
    workgroupBarrier();
    var sums = Sums(vec4<f32>(0.0), vec4<f32>(0.0));
    for (var i = 0u; i < thread; i++) { sums.before += of_threads[i]; }
    for (var i = thread + 1u; i < 32u; i++) { sums.behind += of_threads[i]; }
    return sums;
}
// The sums of all threads, in the same order on each.
fn total(thread: u32, own: vec4<f32>) -> vec4<f32> {
    workgroupBarrier();
    of_threads[thread] = own;
    workgroupBarrier();
    var sum = vec4<f32>(0.0);
    for (var i = 0u; i < 32u; i++) { sum += of_threads[i]; }
    return sum;
}
// The first sample of a thread and the one behind its last, of so many samples of a ray.
fn run_of(thread: u32, samples: u32) -> vec2<u32> {
    let each = (samples + 31u) / 32u;
    return min(vec2<u32>(thread, thread + 1u) * each, vec2<u32>(samples));
}
