"""The vocabulary that every other room speaks.  Core imports no other room.

Start with `arrays`: it states the layout of every array once.

- `errors`: what vialight raises, in one line that says what to do
- `mesh`, `columns`: triangle meshes, and meshes cut by parallel columns
- `config`: the rig's tables, and what their values may be
- `plan`: what a print is made from
- `messages`: what the processes of one print tell each other
- `codec`: messages as bytes and back
- `drawing`: pictures as PNG, in one style
- `compiling`: how all kernels are compiled
"""
