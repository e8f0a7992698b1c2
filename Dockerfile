# The program in a small image: docker build -t augnerf .
# LPIPS weights and scenes are mounted: -v DIR:/data:ro, and -e AUGNERF_LPIPS_WEIGHTS=DIR.
FROM rust:1-bookworm AS build
WORKDIR /source
COPY . .
RUN CARGO_INCREMENTAL=0 cargo build --release --locked && strip target/release/augnerf

FROM debian:bookworm-slim
COPY --from=build /source/target/release/augnerf /usr/local/bin/augnerf
COPY --from=build /source/LICENSE-MIT /source/LICENSE-APACHE /usr/share/doc/augnerf/
COPY --from=build /source/assets/fonts /usr/share/doc/augnerf/fonts
ENV AUGNERF_DATA=/data
WORKDIR /work
ENTRYPOINT ["augnerf"]
CMD ["--help"]
