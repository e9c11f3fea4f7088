"""The library of bodies: agent definitions made by functions, so that nothing has to ship and any part can be read and changed.

`table` has a row for each word that a scene's `body:` takes. A body is modelled of `surfaces` (lofts and ellipsoids), bound to
joints and made of materials by `modelling`, with `hair` on it; `motions` makes its clips, feet where they are put. Shapes are
made when they are first asked for (`lazy_shapes`).

Of its layers `body`, for crowds, has few triangles and `close` many. Lengths are body lengths; `unit` says how long one is."""
