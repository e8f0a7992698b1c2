{#- A product in f32: a group computes a tile, and a thread a square of it. The depth passes through shared memory, and the next
    part of it is fetched while this one is multiplied. -#}
{%- macro piece(tile, slot) %}
{
    {%- let index = format!("(thread + {}u)", slot * tile.threads) %}
    {%- if !tile.is_even() %}
    if ({{ index }} < {{ tile.pieces }}u) {
    {%- endif %}
    {%- if tile.along_depth %}
    let k = 4u * ({{ index }} % 4u); let at = {{ index }} / 4u;
    {%- else %}
    let k = {{ index }} / {{ tile.fours }}u; let at = {{ index }} % {{ tile.fours }}u;
    {%- endif %}
    {{ caller() }}
    {%- if !tile.is_even() %}
    }
    {%- endif %}
}
{%- endmacro -%}
{%- macro fetch(depth) %}
{%- for tile in tiles %}{% for slot in 0..tile.slots() %}{% call piece(tile, slot) %}
    {%- for j in 0..tile.each() %}
    {{ tile.fetched }}{{ slot }}_{{ j }} = {{ tile.name }}_line({{ tile.first }} + 4u * at + {{ j }}u, {{ depth }} + k, part);
    {%- endfor %}
{%- endcall %}{% endfor %}{% endfor %}
{%- endmacro -%}
{%- macro keep() %}
{%- for tile in tiles %}{% for slot in 0..tile.slots() %}{% call piece(tile, slot) %}
    {%- let of = format!("{}{}", tile.fetched, slot) %}
    {%- if tile.along_depth %}
    {%- for (k, c) in ["x", "y", "z", "w"].iter().enumerate() %}
    {{ tile.name }}[(k + {{ k }}u) * {{ tile.line }}u + at] = vec4<f32>({{ of }}_0.{{ c }}, {{ of }}_1.{{ c }}, {{ of }}_2.{{ c }}, {{ of }}_3.{{ c }});
    {%- endfor %}
    {%- else %}
    {{ tile.name }}[k * {{ tile.line }}u + at] = {{ of }}_0;
    {%- endif %}
{%- endcall %}{% endfor %}{% endfor %}
{%- endmacro -%}
{{ product.operands }}
{%- for tile in tiles %}
var<workgroup> {{ tile.name }}: array<vec4<f32>, {{ tile.numbers }}>;
{%- endfor %}
@compute @workgroup_size({{ threads }})
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let across = {{ product.columns / side }}u; let ty = thread / across; let tx = thread % across;
    let row0 = group.y * {{ product.rows }}u; let col0 = group.x * {{ product.columns }}u; let part = group.z; let depth = depth_of(row0, part);
    {%- for i in 0..side %}{% for q in 0..fours %}
    var s{{ i }}_{{ q }} = vec4<f32>(0.0);
    {%- endfor %}{% endfor %}
    {%- for q in 0..biases %}
    var b{{ q }} = vec4<f32>(0.0);
    {%- endfor %}
    {%- for tile in tiles %}{% for slot in 0..tile.slots() %}{% for j in 0..tile.each() %}
    var {{ tile.fetched }}{{ slot }}_{{ j }} = Four();
    {%- endfor %}{% endfor %}{% endfor %}
    {%- call fetch("0u") %}{% endcall %}
    for (var k0 = 0u; k0 < depth; k0 += 16u) {
        {%- call keep() %}{% endcall %}
        workgroupBarrier();
        if (k0 + 16u < depth) {
            {%- call fetch("k0 + 16u") %}{% endcall %}
        }
        for (var k = 0u; k < 16u; k++) {
            let l = k * {{ tiles[0].line }}u + {{ fours }}u * ty; let r = k * {{ tiles[1].line }}u + {{ fours }}u * tx;
            {%- for q in 0..fours %}
            let l{{ q }} = left[l + {{ q }}u]; let r{{ q }} = right[r + {{ q }}u];
            {%- endfor %}
            {%- for i in 0..side %}{% for q in 0..fours %}
            s{{ i }}_{{ q }} = fma(vec4<f32>(l{{ i / 4 }}[{{ i % 4 }}]), r{{ q }}, s{{ i }}_{{ q }});
            {%- endfor %}{% endfor %}
            {%- for q in 0..biases %}
            {#- A bias has no part in derivatives. #}
            {% if product.has_jets %}if (k % 4u == 0u) {% endif %}{ b{{ q }} += r{{ q }}; }
            {%- endfor %}
        }
        workgroupBarrier();
    }
    {%- for i in 0..side %}{% for q in 0..fours %}
    {%- let place = format!("row0 + {0}u * ty + {1}u, col0 + {0}u * tx + {2}u, s{1}_{3}", self.side, i, 4 * q, q) %}
    {%- if product.has_jets && product.name == "product" %}
    store_jet({{ place }}, s{{ i - i % 4 }}_{{ q }}, part);
    {%- else %}
    store_four({{ place }}, part);
    {%- endif %}
    {%- endfor %}{% endfor %}
    {%- if biases > 0 %}
    if (ty == 0u && group.y == 0u) {
        {%- for q in 0..biases %}
        store_bias(col0 + {{ side }}u * tx + {{ 4 * q }}u, b{{ q }}, part);
        {%- endfor %}
    }
    {%- endif %}
}
