{#- A product by matrix units: operands in f16, sums in f32. A group has 8 subgroups of 32 threads, each with 32 rows and half of
    the columns. -#}
{%- macro place(tile, slot) %}
    {%- let index = format!("(thread + {}u)", slot * tile.threads) -%}
    let line = {{ index }} / {{ tile.fours }}u; let four = {{ index }} % {{ tile.fours }}u;
{%- endmacro -%}
{%- macro fetch(depth) %}
{%- for tile in tiles %}{% for slot in 0..tile.slots() %}
    { {% call place(tile, slot) %}{% endcall %} {{ tile.fetched }}{{ slot }} = {{ tile.name }}_line(
    {%- if tile.along_depth %}{{ tile.first }} + line, {{ depth }} + 4u * four{% else %}{{ tile.first }} + 4u * four, {{ depth }} + line{% endif %}, part); }
{%- endfor %}{% endfor %}
{%- endmacro -%}
enable f16;
enable wgpu_cooperative_matrix;
{{ product.operands }}
{%- for tile in tiles %}
var<workgroup> {{ tile.name }}: array<Half, {{ tile.numbers }}>;
{%- endfor %}
{#- A matrix of each subgroup, or the threads' sums of D. #}
var<workgroup> stage: array<f32, 2560>;
@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let row0 = group.y * {{ product.rows }}u; let col0 = group.x * {{ product.columns }}u; let part = group.z; let depth = depth_of(row0, part);
    let subgroup = thread / 32u; let lane = thread % 32u;
    let r0 = (subgroup / 2u) * 32u; let c0 = (subgroup % 2u) * {{ product.columns / 2 }}u;
    {%- for i in 0..2 %}{% for j in 0..across %}
    var s{{ i }}_{{ j }} = coop_mat16x16<f32, C>();
    {%- endfor %}{% endfor %}
    var sums = vec4<f32>(0.0);
    {%- for tile in tiles %}{% for slot in 0..tile.slots() %}
    var {{ tile.fetched }}{{ slot }} = Four();
    {%- endfor %}{% endfor %}
    {%- call fetch("0u") %}{% endcall %}
    for (var k0 = 0u; k0 < depth; k0 += 32u) {
        {%- for tile in tiles %}{% for slot in 0..tile.slots() %}
        { {% call place(tile, slot) %}{% endcall %} {{ tile.name }}[line * {{ tile.line }}u + four] = {{ tile.fetched }}{{ slot }}; }
        {%- endfor %}{% endfor %}
        {%- if product.name == "weights" %}{% for tile in tiles[1..] %}{% for slot in 0..tile.slots() %}
        sums += four_of_Half(d{{ slot }});
        {%- endfor %}{% endfor %}{% endif %}
        workgroupBarrier();
        if (k0 + 32u < depth) {
            {%- call fetch("k0 + 32u") %}{% endcall %}
        }
        {%- for k in (0..32).step_by(16) %}
        {%- for i in 0..2 %}
        let l{{ k }}_{{ i }} = {{ tiles[0].load("A", format!("r0 + {}u", 16 * i), k) }};
        {%- endfor %}
        {%- for j in 0..across %}
        let r{{ k }}_{{ j }} = {{ tiles[1].load("B", format!("c0 + {}u", 16 * j), k) }};
        {%- for i in 0..2 %}
        s{{ i }}_{{ j }} = coopMultiplyAdd(l{{ k }}_{{ i }}, r{{ k }}_{{ j }}, s{{ i }}_{{ j }});
        {%- endfor %}{% endfor %}{% endfor %}
        workgroupBarrier();
    }
    {#- A subgroup's matrices, one after another through shared memory. #}
    {%- for i in 0..2 %}{% for j in 0..across %}
    coopStoreT(s{{ i }}_{{ j }}, &stage[subgroup * 320u], 20u);
    workgroupBarrier();
    {
        let at = subgroup * 320u + (lane / 2u) * 20u + (lane % 2u) * 8u;
        let row = row0 + r0 + {{ 16 * i }}u + lane / 2u; let col = col0 + c0 + {{ 16 * j }}u + (lane % 2u) * 8u;
        store_four(row, col, vec4<f32>(stage[at], stage[at + 1u], stage[at + 2u], stage[at + 3u]), part);
        store_four(row, col + 4u, vec4<f32>(stage[at + 4u], stage[at + 5u], stage[at + 6u], stage[at + 7u]), part);
    }
    workgroupBarrier();
    {%- endfor %}{% endfor %}
    {%- if product.name == "weights" %}
    {#- The sums of D, which all threads have parts of. #}
    for (var j = 0u; j < 4u; j++) { stage[4u * thread + j] = sums[j]; }
    workgroupBarrier();
    if (thread < {{ product.columns / 4 }}u && group.y == 0u) {
        var total = vec4<f32>(0.0);
        for (var i = thread; i < 256u; i += {{ product.columns / 4 }}u) {
            total += vec4<f32>(stage[4u * i], stage[4u * i + 1u], stage[4u * i + 2u], stage[4u * i + 3u]);
        }
        store_bias(col0 + 4u * thread, total, part);
    }
    {%- endif %}
}
