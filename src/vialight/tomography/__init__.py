"""From camera frames to the volume of the density.

Start with `reconstruct`: it holds the steps in their order.

- `sinogram`: frames become parallel rays
- `volume`: parallel rays become a volume
- `radon`: the filters and backprojectors that `volume` calls
- `sliding`: the volume of the latest turn, renewed with every frame
"""
