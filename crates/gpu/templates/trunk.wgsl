{#- The layers of a trunk, one after another, by matrix units: what one leaves stays in shared memory for the next. A group has 8
    subgroups of 32 threads, each with {{ 16 * deep }} rows and 32 columns. -#}
{%- macro multiply(depth, places, function, stride) %}
            for (var k = 0u; k < {{ depth }}; k += 16u) {
                {%- for i in 0..self.deep %}
                let l{{ i }} = coopLoadT<coop_mat16x16<f16, A>>(&left[(r0 + {{ 16 * i }}u) * LINE + k / 4u], LINE);
                {%- endfor %}
                {%- for j in 0..2 %}
                let w{{ j }} = {{ function }}<coop_mat16x16<f16, B>>(&right[({{ places }} + {{ 16 * j }}u{{ stride }}) / 4u], {{ self.width / 4 }}u);
                {%- for i in 0..self.deep %}
                s{{ i }}_{{ j }} = coopMultiplyAdd(l{{ i }}, w{{ j }}, s{{ i }}_{{ j }});
                {%- endfor %}{% endfor %}
            }
{%- endmacro -%}
enable f16;
enable wgpu_cooperative_matrix;
{{ operands }}
// Columns, rows of a group, and fours of a row in shared memory.
const WIDTH: u32 = {{ width }}u;
const ROWS: u32 = {{ rows }}u;
const LINE: u32 = {{ line }}u;
var<workgroup> left: array<Half, ROWS * LINE>;
{#- A matrix of each subgroup. #}
var<workgroup> stage: array<f32, 2560>;
@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    row_count = rows();
    let row0 = (group.x + group.y * 65535u) * ROWS;
    let subgroup = thread / 32u; let lane = thread % 32u;
    let r0 = subgroup / {{ width / 32 }}u * {{ 16 * deep }}u; let c0 = subgroup % {{ width / 32 }}u * 32u;
    {%- if is_back %}
    var first = p.end;
    fetch(row0, thread);
    workgroupBarrier();
    {#- A group without a row that counts has no layer. #}
    let lowest = select(p.layers, p.lowest, row0 < row_count);
    for (var layer = p.layers - 1u; layer >= lowest; layer--) {
    {%- else %}
    var first = 0u;
    for (var layer = 0u; layer < p.layers; layer++) {
    {%- endif %}
        let of_encoding = select(0u, p.channels, layer == 0u || (p.skips >> layer & 1u) == 1u);
        let hidden = select({{ width }}u, 0u, layer == 0u);
        let size = (of_encoding + hidden + 1u) * {{ width }}u;
        {%- if is_back %}
        first -= size;
        {%- endif %}
        {%- for i in 0..self.deep %}{% for j in 0..2 %}
        var s{{ i }}_{{ j }} = coop_mat16x16<f32, C>();
        {%- endfor %}{% endfor %}
        {%- if is_back %}
        {%- call multiply("hidden", format!("first + (of_encoding + c0) * {}u + k", self.width), "coopLoad", format!(" * {}u", self.width)) %}{% endcall %}
        {%- else %}
        {%- call multiply("hidden", format!("first + (of_encoding + k) * {}u + c0", self.width), "coopLoadT", "") %}{% endcall %}
        {#- Not behind a condition: matrix units need the same control flow in all threads. #}
        workgroupBarrier();
        fetch(row0, thread, of_encoding / 4u);
        workgroupBarrier();
            {%- call multiply("of_encoding", format!("first + k * {}u + c0", self.width), "coopLoadT", "") %}{% endcall %}
        {%- endif %}
        workgroupBarrier();
        {%- for i in 0..self.deep %}{% for j in 0..2 %}
        coopStoreT(s{{ i }}_{{ j }}, &stage[subgroup * 320u], 20u);
        workgroupBarrier();
        {
            let at = subgroup * 320u + lane / 2u * 20u + lane % 2u * 8u;
            let local = r0 + {{ 16 * i }}u + lane / 2u; let col = c0 + {{ 16 * j }}u + lane % 2u * 8u; let bias = first + size - {{ width }}u;
            leave(local, row0 + local, col, layer, bias, vec4<f32>(stage[at], stage[at + 1u], stage[at + 2u], stage[at + 3u]));
            leave(local, row0 + local, col + 4u, layer, bias, vec4<f32>(stage[at + 4u], stage[at + 5u], stage[at + 6u], stage[at + 7u]));
        }
        workgroupBarrier();
        {%- endfor %}{% endfor %}
        {%- if !is_back %}
        first += size;
        {%- endif %}
    }
}
