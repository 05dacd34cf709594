;;; anmech: for which values of its parameters a system of linear partial differential equations may have more
;;; solutions.
;;;
;;; The completed system (janet.lisp) at a point is a matrix, whose rank falls wherever there are more solutions: then
;;; each of its largest minors vanishes.  A minor is a polynomial in the parameters.  It is computed modulo a prime,
;;; along lines in the space of parameters, where it is the product of the pivots of an elimination, always of the same
;;; rows and columns; its degree is small, since most rows hold no parameter.  From its square-free part on enough lines
;;; through one point comes the polynomial itself, with rational coefficients.
;;;
;;; Two things are told.  What divides minors at two different random points, whatever the parameters are, are the
;;; conditions that one equation between parameters makes (COMMON).  All of one minor, at a simple point (WHOLE), unless
;;; at a random one it is nothing but that, contains also the conditions that are made of several equations: each of its
;;; factors, put to zero, leaves fewer parameters, and so on.  So all values at which there are more solutions are
;;; found, up to accidents modulo a prime; the kernels that nodes.lisp takes to be independent are so here, too, and
;;; where these depend on each other for special exponents, others must tell.
;;;
;;; Not for systems with roots of parameters, or unknown functions of them.
;;;
;;; Entry point: anmech_degenerate_parameters, with equations as for anmech_dimension (janet.lisp).
;;;
;;; Literature: R. Zippel, Effective Polynomial Computation (1993), chapters 13 and 14; E. Kaltofen and B. Trager,
;;; Computing with polynomials given by black boxes for their evaluations, J. Symbolic Comput. 9 (1990) 301; for the
;;; question, G. J. Reid and A. D. Wittkopf, Determination of maximal symmetry groups of classes of differential
;;; equations, ISSAC (2000) 272.

(in-package :anmech)
(needs "session/outcomes" "session/patience" "arithmetic/polynomials" "arithmetic/residues" "arithmetic/series"
       "algebra/nodes" "algebra/sparse" "algebra/terms" "determining/janet")

(defparameter *most-values* 300 "The degree of a minor on a line is less than that.")
(defparameter *most-coefficients* 700 "A polynomial that may have more coefficients is not computed.")

;;; Scenes

(defstruct scene
  "A completed SYSTEM at a POINT, whose PARAMETERS, nodes, move.  LEVEL: the order of its rows, WIDTH of these.  MINOR:
the one that is computed here."
  system point instances level parameters width minor)

(defun new-scene (system place turn parameters)
  "Nil where there are infinitely many solutions."
  (multiple-value-bind (completion point instances) (completed system place -1 nil turn)
    (when (completion-dimension completion)
      (make-scene :system system :point point :instances instances :level (completion-level completion)
                  :parameters parameters
                  :width (* (pde-system-functions system)
                            (monomials-count (monomials-up-to (pde-system-variables system)
                                                              (completion-level completion))))))))

(defun node-holds-p (node test)
  (or (funcall test node) (some (lambda (part) (node-holds-p part test)) (node-parts node))))

(defun polynomial-in-parameters-p (system parameters)
  "Whether no root, nor an unknown function, is taken of what holds PARAMETERS."
  (labels ((holds-p (node) (node-holds-p node (lambda (part) (member part parameters))))
           (harmless-p (node)
             (and (not (and (member (node-kind node) '(:base :function :root-sum)) (holds-p node)))
                  (every #'harmless-p (node-parts node)))))
    (loop for equation in (pde-system-equations system)
          always (loop for (node) in (equation-terms equation) always (harmless-p node)))))

(defun copied-point (point change)
  "POINT with the residues (funcall CHANGE node residue); without those that are nil."
  (let ((residues (make-hash-table :test #'eq)))
    (maphash (lambda (node residue)
               (let ((new (funcall change node residue))) (when new (setf (gethash node residues) new))))
             (point-residues point))
    (make-point :prime (point-prime point) :state (point-state point) :residues residues
                :functions (point-functions point))))

(defun point-of-parameters (scene values)
  (let ((point (copied-point (scene-point scene) (lambda (node residue) (declare (ignore node)) residue))))
    (loop for node in (scene-parameters scene) for value in values
          do (setf (gethash node (point-residues point)) value))
    point))

(defun varying-kernels (system)
  "The nodes of the exponentials and logarithms that variables are in, always in the same order."
  (let ((found '()))
    (labels ((varies-p (node) (node-holds-p node (lambda (part) (eq (node-kind part) :variable))))
             (walk (node)
               (case (node-kind node)
                 (:exponential (mapc (lambda (pair) (note (car pair))) (node-data node)))
                 (:logarithm (note node)))
               (mapc #'walk (node-parts node)))
             (note (node) (when (varies-p node) (pushnew node found))))
      (dolist (equation (pde-system-equations system) (nreverse found))
        (loop for (node) in (equation-terms equation) do (walk node))))))

(defun simple-scene (scene places kernels)
  "SCENE where the variables are PLACES, and exponentials and the like KERNELS, an alist from nodes to numbers: nothing
is random there, so minors are polynomials with rational coefficients."
  (flet ((varies-p (node) (node-holds-p node (lambda (part) (eq (node-kind part) :variable)))))
    (let ((other (copy-scene scene)))
      (setf (scene-point other)
            (copied-point (scene-point scene)
                          (lambda (node residue)
                            (cond ((eq (node-kind node) :variable) (nth (node-data node) places))
                                  ((assoc node kernels) (cdr (assoc node kernels)))
                                  ((and (eq (node-kind node) :base) (varies-p node)) nil)
                                  (t residue)))))
      other)))

;;; Rows

(defun scene-rows (scene values)
  "All rows of the completed system with these VALUES of the parameters, always in the same order; or :left."
  (let* ((system (scene-system scene)) (lowest (pde-system-lowest system)))
    (at-point (point-of-parameters scene values)
              (monomials-up-to (pde-system-variables system) (- (scene-level scene) lowest))
              (lambda ()
                (let ((rows (rows-at-samples (scene-instances scene) (pde-system-functions system))))
                  (loop for level from lowest to (scene-level scene)
                        append (derivatives-of-rows rows level system)))))))

(defun permuted-row (row order)
  (loop for (column . entry) in row collect (cons (aref (the residues order) column) entry)))

(defun shuffled (list)
  (mapcar #'cdr (sort (mapcar (lambda (element) (cons (random-residue) element)) list) #'< :key #'car)))

(defun column-order (scene shuffle)
  "A permutation of the columns, a random one within each order if SHUFFLE."
  (let* ((system (scene-system scene)) (functions (pde-system-functions system)) (start 0))
    (fixnums (loop for end across (the residues (monomials-ends (monomials-up-to (pde-system-variables system)
                                                                                 (scene-level scene))))
                   append (let ((columns (loop for column from start below (* functions end) collect column)))
                            (setq start (* functions end))
                            (if shuffle (shuffled columns) columns))))))

;;; Minors

(defstruct minor
  "ORDER: a permutation of the columns.  FIXED: the echelon of the rows that hold no parameters.  CHOSEN: pairs of the
number of another row and the column of its pivot.  RANK: of all."
  order fixed chosen rank)

(defun chosen-minor (scene rows others shuffle)
  "A largest minor that does not vanish; ROWS and OTHERS are those of SCENE for two values of the parameters."
  (let* ((order (column-order scene shuffle)) (fixed (new-echelon (scene-width scene))) (chosen '()))
    (flet ((insert (row echelon) (insert-row (permuted-row row order) echelon 0)))
      (loop for row in rows for other in others
            when (and row (equal row other)) do (insert row fixed))
      (let ((echelon (new-echelon (scene-width scene) fixed)))
        (loop for row in rows for other in others for number from 0
              unless (equal row other)
                do (multiple-value-bind (entry column) (insert row echelon)
                     (when entry (push (cons number column) chosen))))
        (make-minor :order order :fixed fixed :chosen (nreverse chosen)
                    :rank (count-if #'identity (echelon-pivots echelon)))))))

(defun minor-value (minor rows)
  "Up to a constant; nil where the elimination takes another course."
  (let* ((echelon (new-echelon (length (minor-order minor)) (minor-fixed minor))) (product 1)
         (rows (coerce rows 'simple-vector)))
    (loop for (number . column) in (minor-chosen minor)
          do (multiple-value-bind (entry lead)
                 (insert-row (permuted-row (svref rows number) (minor-order minor)) echelon 0)
               (cond ((null entry) (return 0))
                     ((/= lead column) (return nil))
                     (t (setq product (mod (* product entry) *prime*)))))
          finally (return product))))

(defun on-line (base direction s)
  (loop for a in base for b in direction collect (mod (+ a (* s b)) *prime*)))

(defun with-minor (scene shuffle)
  "SCENE with a minor; nil if it is no place to be."
  (let ((rows (loop repeat 2 collect (scene-rows scene (random-values (length (scene-parameters scene)))))))
    (unless (member :left rows)
      (setf (scene-minor scene) (chosen-minor scene (first rows) (second rows) shuffle))
      scene)))

(defun random-values (count) (loop repeat count collect (random-residue)))

(defun minor-on-line (scene base direction)
  "The square-free part of the minor at BASE + s * DIRECTION, a polynomial in s; or nil."
  (let ((polynomial (interpolated-polynomial
                     (lambda (s)
                       (poll)
                       (let ((rows (scene-rows scene (on-line base direction s))))
                         (if (eq rows :left) nil (minor-value (scene-minor scene) rows))))
                     *most-values*)))
    (and polynomial (square-free-part polynomial))))

(defun square-free-part (polynomial)
  (reduce #'polynomial-product (mapcar #'cdr (square-free-parts (monic-polynomial polynomial)))
          :initial-value '(1)))

;;; What is known already: polynomials in the parameters, as nodes

(defun node-on-line (node scene base direction)
  (interpolated-polynomial
   (lambda (s)
     (let ((value (at-point (point-of-parameters scene (on-line base direction s))
                            (monomials-up-to (pde-system-variables (scene-system scene)) 0)
                            (lambda () (constant-part (series-of node))))))
       (if (eq value :left) nil value)))
   *most-values*))

(defun without-known (polynomial known)
  "POLYNOMIAL without the factors of KNOWN that it has; and for each of KNOWN whether it divides it."
  (let* ((rest polynomial)
         (flags (loop for factor in known
                      collect (and (rest factor)
                                   (null (nth-value 1 (divided-polynomial polynomial factor)))
                                   (setq rest (values (divided-polynomial rest (common-divisor rest factor))))))))
    (values rest flags)))

;;; Polynomials in several variables from their square-free parts on lines

(defun interpolated-form (count line)
  "A list of monomials and coefficients, those of the polynomial in COUNT variables that on each line is the polynomial
(funcall LINE base direction), up to a factor; nil if it has too many."
  (let* ((monomials (form-monomials count line)) (width (length monomials)) (echelon (new-echelon width)) (idle 0))
    (unless (> width *most-coefficients*)
      (loop until (or (= idle 2) (= (1- width) (count-if #'identity (echelon-pivots echelon))))
            do (let* ((base (random-values count)) (direction (random-values count))
                      (polynomial (or (funcall line base direction) (return-from interpolated-form nil))))
                 (if (some #'identity (mapcar (lambda (row) (insert-equation row echelon))
                                              (line-equations polynomial monomials base direction)))
                     (setq idle 0)
                     (incf idle))))
      (let ((vector (null-vector-of echelon)))
        (and vector (list monomials vector))))))

(defun form-monomials (count line)
  "Those that may occur: of no higher degree than on random lines, together and in each of the variables."
  (let ((base (random-values count)))
    (flet ((degree (direction) (1- (length (funcall line base direction)))))
      (let ((degrees (loop for k below count
                           collect (degree (loop for j below count collect (if (= j k) 1 0))))))
        (loop for exponents across (monomials-exponents (monomials-up-to count (max 0 (degree (random-values count)))))
              when (every #'<= exponents degrees) collect exponents)))))

(defun line-equations (polynomial monomials base direction)
  "What a polynomial's coefficients satisfy if on a line it is a multiple of POLYNOMIAL."
  (let ((scale (inverse-residue (first polynomial)))
        (start (mapcar (lambda (exponents) (monomial-residue exponents base)) monomials)))
    (loop for s from 1 to (length polynomial)
          for factor = (mod (* scale (value-of-polynomial polynomial s)) *prime*)
          for values = (on-line base direction s)
          collect (loop for exponents in monomials
                        for value in start
                        collect (mod (- (monomial-residue exponents values) (* factor value)) *prime*)))))

(defun surely-rational (residue modulus)
  "The rational number that RESIDUE modulo MODULUS is by no accident, or nil."
  (let ((number (rational-from-residue residue modulus)))
    (and number
         (<= (* (abs (numerator number)) (denominator number)) (ash modulus -16))
         number)))

(defun rational-form (count line-at)
  "The polynomial with rational coefficients that comes of the LINEs of (funcall LINE-AT place), a scene's prime being
bound there, and nil if there is none."
  (let ((residues nil) (modulus 1) (monomials nil))
    (dotimes (place 3)
      (funcall line-at place
               (lambda (line)
                 (destructuring-bind (&optional found vector) (interpolated-form count line)
                   (unless (and found (or (null monomials) (equal found monomials)))
                     (return-from rational-form nil))
                   (setq residues (if residues
                                      (mapcar (lambda (a b) (joined-residue a modulus b *prime*)) residues vector)
                                      vector)
                         monomials found
                         modulus (* modulus *prime*)))))
      (let ((numbers (mapcar (lambda (residue) (surely-rational residue modulus)) residues)))
        (unless (member nil numbers)
          (return (list monomials numbers)))))))

;;; The answer

(defparameter *simple-places* '((0 0 1 0) (1 0 1 0) (0 1 1 1) (1 1 1 1) (2 1 2 1) (2 3 2 3) (7 -2 3 2))
  "Values of variables, that of the first one and their step; of kernels, likewise.")

(defun simple-scenes-like (scene)
  "The simple scenes with minors as large as those of SCENE."
  (unless (some #'cdr (scene-instances scene))
    (loop with kernels = (varying-kernels (scene-system scene))
          for (start step first-kernel kernel-step) in *simple-places*
          for places = (loop for k below (pde-system-variables (scene-system scene))
                             collect (mod (+ start (* k step)) *prime*))
          for values = (loop for node in kernels
                             for k from 0 collect (cons node (+ first-kernel (* k kernel-step))))
          for other = (with-minor (simple-scene scene places values) nil)
          when (and other (= (minor-rank (scene-minor other)) (minor-rank (scene-minor scene))))
            collect other)))

(defun simplest-scene (scene)
  "That one of them whose minor has the lowest degree on a line; :none if there is none."
  (let* ((count (length (scene-parameters scene)))
         (base (random-values count)) (direction (random-values count)) (best :none) (least most-positive-fixnum))
    (dolist (other (simple-scenes-like scene) best)
      (let ((polynomial (minor-on-line other base direction)))
        (when (and polynomial (< (length polynomial) least))
          (setq best other least (length polynomial)))))))

(defstruct (scenes (:type list))
  "Two random ones; a simple one, :none if there is none, nil as long as none was asked for."
  one two simple)

(defun scenes-at (system parameters place)
  "Nil where there are none with the same prime."
  (let ((one (new-scene system place 0 parameters)) (two (new-scene system place 1 parameters)))
    (when (and one two (= (point-prime (scene-point one)) (point-prime (scene-point two))))
      (call-in-scene one (lambda ()
                           (when (and (with-minor one nil) (with-minor two t))
                             (list one two nil)))))))

(defun call-in-scene (scene thunk)
  "THUNK with the prime and the random numbers of SCENE; nil where a division by zero comes in its way."
  (let* ((*point* (scene-point scene)) (*prime* (point-prime *point*))
         (value (catch 'point (funcall thunk))))
    (if (eq value :left) nil value)))

(defun common-on-line (scenes base direction)
  "What the minors at the two random points have in common; and whether one of them is nothing else."
  (let ((one (minor-on-line (scenes-one scenes) base direction))
        (two (minor-on-line (scenes-two scenes) base direction)))
    (when (and one two)
      (let ((common (common-divisor one two)))
        (values common (= (length common) (min (length one) (length two))))))))

(defun simple-on-line (scenes base direction)
  (unless (scenes-simple scenes)
    (setf (scenes-simple scenes) (simplest-scene (scenes-one scenes))))
  (and (scene-p (scenes-simple scenes)) (minor-on-line (scenes-simple scenes) base direction)))

(defun rest-on-line (function scenes known base direction)
  "What is left of (funcall FUNCTION scenes base direction) without the factors KNOWN; whether each of these divides it;
and the second value of the function."
  (multiple-value-bind (polynomial more) (funcall function scenes base direction)
    (when polynomial
      (multiple-value-bind (rest flags)
          (without-known polynomial (loop for node in known
                                          collect (node-on-line node (scenes-one scenes) base direction)))
        (values rest flags more)))))

(defun rest-as-form (function system parameters known place first)
  "The polynomial that is left, or nil."
  (rational-form (length parameters)
                 (lambda (further use)
                   (let ((scenes (if (= further 0) first (scenes-at system parameters (+ place further)))))
                     (when scenes
                       (call-in-scene (scenes-one scenes)
                                      (lambda ()
                                        (funcall use (lambda (base direction)
                                                       (rest-on-line function scenes known base direction))))))))))

(defun degenerations (system parameters known place)
  "A list of whether KNOWN are common; of whether they are in the whole, or :none; and what is left: of what is common,
else of the whole, a list of monomials and coefficients, nil if that is too much, or 1.  Nil if nothing is known."
  (let ((scenes (and (polynomial-in-parameters-p system parameters) (scenes-at system parameters place))))
    (when scenes
      (call-in-scene
       (scenes-one scenes)
       (lambda ()
         (let ((base (random-values (length parameters))) (direction (random-values (length parameters))))
           (flet ((look (function) (multiple-value-list (rest-on-line function scenes known base direction)))
                  (rest-of (function) (rest-as-form function system parameters known place scenes)))
             (destructuring-bind (&optional common flags alone) (look #'common-on-line)
               (destructuring-bind (&optional whole others &rest nothing)
                   (if alone (list common flags) (look #'simple-on-line))
                 (declare (ignore nothing))
                 (when common
                   (list flags
                         (if whole others :none)
                         (cond ((rest common) (rest-of #'common-on-line))
                               ((rest whole) (rest-of #'simple-on-line))
                               (t 1)))))))))))))

(defun polynomial-form (monomials numbers parameters)
  (sum-of (loop for exponents in monomials
                for number in numbers
                unless (= number 0)
                  collect (apply #'product-of (number-form number) (mapcar #'power-of parameters exponents)))))

(maxima::defmfun maxima::$anmech_degenerate_parameters (equations functions variables moving parameters known place)
  "anmech_degenerate_parameters(equations, m, x, v, [p, ..], [f, ..], place): [common, whole, rest].  Where there are
more solutions, and one equation between the parameters p makes that, one of the f that are true in the list COMMON
vanishes; anyway one of those that are true in WHOLE, if that is a list.  REST is a polynomial of which the same must be
said; 1; or false if it was not found.  With another PLACE, another prime.  Not found where nothing is known."
  (let ((found (call-with-system
                (lambda (system)
                  (degenerations system (mapcar #'coefficient-node (rest parameters))
                                 (mapcar #'coefficient-node (rest known)) place))
                equations functions variables moving)))
    (if (null found)
        (maxima::$anmech_not_found 'maxima::$parameters)
        (destructuring-bind (common whole rest) found
          (maxima-list (list (maxima-list (mapcar (lambda (flag) (and flag t)) common))
                             (if (eq whole :none) nil (maxima-list (mapcar (lambda (flag) (and flag t)) whole)))
                             (if (consp rest)
                                 (polynomial-form (first rest) (second rest) (rest parameters))
                                 rest)))))))
