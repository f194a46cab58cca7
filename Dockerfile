# The program alone: docker build -t pbgi . && docker run --rm -v "$PWD:/data" pbgi bake room.glb -o room.pbgi
FROM rust:1.95-alpine AS build
RUN apk add --no-cache musl-dev tar
WORKDIR /source
COPY . .
RUN cargo xtask dist && mv target/dist/*/ /pbgi

# Static: it needs nothing of a system. Its licenses and manual lie beside it; temporary files go beside the output.
FROM scratch
COPY --from=build /pbgi /pbgi
WORKDIR /data
ENTRYPOINT ["/pbgi/pbgi"]
