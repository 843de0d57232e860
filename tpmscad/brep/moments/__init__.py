"""Volume, area and centroid of boundary representations by quadrature."""
